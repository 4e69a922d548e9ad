"""The report: an honest verdict, what is missing of an interrupted run, a page that is safe and needs no network."""

import itertools
import json
import re
from datetime import date
from html.parser import HTMLParser
from types import SimpleNamespace
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
from plans import CONFIG, make_plan

from probe_agents.cli import main
from probe_agents.evaluation import profiles, report
from probe_agents.evaluation.folder import UNFINISHED, comparable, read_evaluation
from probe_agents.evaluation.kpis import CORE, KPIS, PROFILE_COLUMNS
from probe_agents.evaluation.report import compare_with_best, limit_of, oracle_policies, write_report
from probe_agents.evaluation.run import evaluate_plan, print_summary
from probe_agents.evaluation.statistics import grouped, ranking
from probe_agents.policies.catalogue import named_policies
from probe_agents.policies.fixed import PI, Constant, Scheduled
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import ROUND_TRIP_PRESETS
from probe_env.schedule import Schedule

MINE = Schedule("time", "linear", (0.0, 0.2), (0.15, 0.3), (0.02, 0.03))


def table_of(times, fractions, rewards, tubes=20, scatter=0.0):
    """Policies on the same tubes, whose differences scatter by so much of what they are."""
    rng, rows = np.random.default_rng(3), []
    columns = {"inspection_time_s": times, "share_within_limit": fractions, "reward": rewards}
    for policy in times:
        for context in range(tubes):
            values = {name: value[policy] * (1.0 + scatter * rng.normal()) for name, value in columns.items()}
            row = dict.fromkeys((*CORE, "complete"), 1.0) | {"lost_drive": 0.0, "diverged": 0.0} | values
            rows.append(row | {"policy": policy, "context": context, "seed": 0})
    return pd.DataFrame(rows)


TIMES, FRACTIONS, REWARDS = {"mine": 361.0, "best": 300.0}, {"mine": 0.9, "best": 0.9}, {"mine": 1.0, "best": 9.0}


def cells_of(comparison):
    """Head -> texts of the cells."""
    return {head.text: [cell.text for cell in cells] for head, *cells in comparison.table[1]}


def test_comparison_with_the_best_other_policy():
    one = compare_with_best(table_of(TIMES, FRACTIONS | {"mine": 0.85}, REWARDS), "mine", ())
    assert (one.result, one.best, one.first) == ("worse than", "best", False)
    assert cells_of(one) == {
        "reward": ["1", "9", "-8"], "inspection time [s]": ["361", "300", "+61"],
        "length within the limit [%]": ["85", "90", "-5"], "complete": ["20 of 20", "20 of 20", ""],
    }  # fmt: skip
    other = compare_with_best(table_of(TIMES, FRACTIONS, REWARDS), "best", ())
    assert (other.result, other.best, other.first) == ("better than", "mine", True)
    scattered = compare_with_best(table_of(TIMES, FRACTIONS, REWARDS, scatter=0.01), "mine", ())
    low, high = map(float, scattered.table[1][1][3].below.split(" to "))
    assert low < 61.0 < high  # 20 differences of 4.7 s scatter: the mean is within 1.05 s (standard error)
    same = table_of(TIMES | {"mine": 300.0}, FRACTIONS, REWARDS | {"mine": 9.0}, scatter=0.05)
    for policy, first in zip(ranking(same), (True, False), strict=True):
        assert compare_with_best(same, policy, ())[2:4] == ("no clear difference from", first)
    oracle = table_of(TIMES | {"oracle": 200.0}, FRACTIONS | {"oracle": 1.0}, REWARDS | {"oracle": 20.0})
    assert [compare_with_best(oracle, name, {"oracle"}).best for name in ("best", "mine")] == ["mine", "best"]


def test_comparison_with_failures_one_tube_or_no_other_policy():
    table = table_of(TIMES, FRACTIONS, REWARDS)
    table.loc[[0, 1], ["complete", "lost_drive"]] = 0.0, 1.0
    assert cells_of(compare_with_best(table, "mine", ()))["complete"] == ["18 of 20", "20 of 20", ""]
    for tubes in (1, 4):
        one = compare_with_best(table_of(TIMES, FRACTIONS, REWARDS, tubes=tubes, scatter=0.05), "mine", ())
        assert bool(one.table[1][0][3].below) == (tubes > 1)
    alone = compare_with_best(table[table["policy"] == "best"], "best", ())
    assert (alone.best, cells_of(alone)["reward"]) == ("", ["9"])


def test_limit_with_its_unit():
    tasks = {"vibration_limit": 5e-5}, {"vibration_measure": "velocity"}, {"vibration_measure": "acceleration"}
    assert [limit_of(TaskConfig(**task)) for task in tasks] == ["0.05 mm", "5 mm/s", "20 m/s²"]


def test_all_common_episodes_are_compared():
    # one tube of three says less than 48 of two
    for counts, kept in (((48, 48, 40), [40, 40, 40]), ((48, 48, 1), [48, 48]), ((7,), [7])):
        stored = [(f"{p}-{k}", f"policy {p}", k, 0) for p, count in enumerate(counts) for k in range(count)]
        chosen = pd.Series([name for _, name, _, _ in comparable(stored)]).value_counts(sort=False)
        assert chosen.to_dict() == {f"policy {k}": count for k, count in enumerate(kept)}


def test_report_of_an_interrupted_evaluation(tmp_path):
    plan, calls = make_plan(4, 3, seeds=(0,)), itertools.count(1)

    def per_metre(profile):
        if next(calls) == 8:
            raise KeyboardInterrupt
        return {name: np.array([k + 0.5]) for k, name in enumerate(PROFILE_COLUMNS)}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probe_agents.evaluation.plan.per_metre", per_metre)
        with pytest.raises(KeyboardInterrupt):
            evaluate_plan(plan, tmp_path)
    done = read_evaluation(tmp_path)
    assert (done.missing.stored, done.missing.planned) == (7, 12)
    assert done.table["policy"].value_counts().to_dict() == {"feed 0": 3, "feed 1": 3}
    assert main(["evaluate", str(tmp_path)]) == 0  # writes the report alone
    page = (tmp_path / "report.html").read_text()
    for text in ("7 of 12 insertions are stored", "<b>feed 1</b>: 1 of 4 ins", "<b>feed 2</b>: 4 of 4 ins"):
        assert text in page
    assert not (tmp_path / "summary.csv").exists()  # of finished evaluations only
    evaluate_plan(plan, tmp_path)
    assert "Not finished" not in (tmp_path / "report.html").read_text()
    assert not (tmp_path / UNFINISHED).exists()


def test_the_hours_of_a_bundle_are_printed_stored_and_reported(tmp_path, capsys):
    """The plan's bundle is in report.json, so that the stored evaluation has the hours again, compared otherwise too.

    Episodes of 0.3 s, 719.7 s of setup and 720 s of withdrawal: 0.4 h a tube.
    """
    bundle = Bundle(tubes=50, setup_time=719.7, withdrawal_time=720.0)
    evaluate_plan(make_plan(bundle=bundle, plant="unit 2"), tmp_path)
    printed, hours = capsys.readouterr().out, pd.read_csv(tmp_path / "bundle.csv")
    assert "Hours for 50 tubes" in printed
    assert hours["policy"].tolist() == ["feed 0", "feed 1"]
    np.testing.assert_allclose(hours[["hours", "hours_low", "hours_high"]], 20.0, rtol=1e-4)
    page = (tmp_path / "report.html").read_text()
    heads = re.findall("<h2>(Hours .*?)</h2>", page)
    assert re.search(rf"Plant: unit 2 .*{date.today():%Y-%m}.* Name: ___", page)
    assert heads == ["Hours for 50 tubes", "Hours for 50 tubes: the other policies"]
    (tmp_path / "bundle.csv").unlink()
    assert main(["evaluate", str(tmp_path), "--against", "feed 1"]) == 0
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "bundle.csv"), hours)
    assert json.loads((tmp_path / "report.json").read_text())["bundle"]["tubes"] == 50


def test_report_of_a_stored_evaluation(stored, tmp_path, capsys, monkeypatch):
    """The same one, or compared with another policy; a folder without one is named."""
    monkeypatch.setattr("probe_agents.evaluation.plan.Episodes", None)  # playing anything would fail
    before = {name: (stored / name).read_bytes() for name in ("report.html", "summary.csv", "report.json")}
    for name in ("report.html", "summary.csv"):
        (stored / name).unlink()
    assert main(["evaluate", str(stored)]) == 0
    assert {name: (stored / name).read_bytes() for name in before} == before
    assert main(["evaluate", str(stored), "--against", "feed 1"]) == 0
    assert "Differences to feed 1" in (stored / "report.html").read_text()
    assert json.loads((stored / "report.json").read_text()) == {"against": "feed 1", "user_policies": []}
    capsys.readouterr()
    assert main(["evaluate", str(stored), "--against", "feed 7"]) == 2
    assert "against = 'feed 7' is not one of the policies: feed 0, feed 1" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main(["evaluate", str(tmp_path / "empty")]) == 2
    assert "no such file: " in capsys.readouterr().err


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Of an evaluation of a schedule, a controller and one whose name is a trap."""
    folder = tmp_path_factory.mktemp("report")
    policies = {"my schedule": Scheduled(CONFIG, MINE), "pi": PI(CONFIG), "</script><img src=x>": Constant(CONFIG)}
    evaluate_plan(make_plan(policies=policies, seeds=(0,)), folder, users=["my schedule"])
    return (folder / "report.html").read_text()


def test_report_begins_with_the_verdict(page):
    quiet, compared = re.findall(r'<p class="headline[^>]*>(.*?)</p>', page)
    assert quiet.startswith("Your schedule <b>my schedule</b> is not quiet: vibration within 0.1 mm in ")
    assert compared.startswith("Your schedule <b>my schedule</b>: ")
    ranked, more = re.findall(r'<table class="ranking">.*?</table>', page, re.DOTALL)
    for kpi, (name, _, unit) in KPIS.items():
        head = f"<th>{name} [{unit}]<" if unit else f"<th>{name}<"
        assert (head in ranked, head in more) == (kpi in report.RANKED, kpi not in report.RANKED), kpi
    for text in ("radial rms of 0.1 mm at the sensor", "bore 24.2 mm, helix 60 m", "By helix diameter", "Tube by tube"):
        assert text in page


def test_report_needs_no_network_and_escapes_names(page):
    assert "default-src 'none'" in page
    assert not re.search(r"@import|url\(", page)
    tags, parser = [], HTMLParser()
    parser.handle_starttag = lambda tag, attributes: tags.append((tag, attributes))
    parser.feed(page)
    addresses = [value for _, given in tags for name, value in given if name in ("src", "href", "action")]
    assert len(addresses) == 8  # five pictures, three schedules
    assert all(address.startswith("data:") for address in addresses)
    assert [name for name, _ in tags].count("script") == page.count("</script>") == 3
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1]
    assert "</script><img src=x>" in [policy["name"] for policy in json.loads(data)["policies"]]


def test_schedules_of_the_page_are_schedules(page, tmp_path):
    links = dict(re.findall(r'<a download="([^"]*)" href="data:text/csv;charset=utf-8,([^"]*)"', page))
    assert set(links) == {"my-schedule.csv", "pi.csv", "script-img-src-x.csv"}
    for name, content in links.items():
        (tmp_path / name).write_text(unquote(content))
        assert Schedule.read(tmp_path / name).over == "inserted_length"


def test_traces_are_what_was_fed(evaluated, monkeypatch):
    table = grouped(pd.read_parquet(evaluated / "episodes.parquet"))
    metres = pd.concat(  # as if they had been fed for four metres
        [pd.read_parquet(evaluated / "profile.parquet").assign(inserted_length=m + 0.5, radial_rms_m=1e-5 * m)
         for m in range(1, 5)]
    )  # fmt: skip
    drawn = profiles.traces(table, grouped(metres), ["feed 0"], 0.1)
    assert drawn["metres"] == [1.5, 2.5, 3.5, 4.5]
    found = [(one["name"], one["shown"], len(one["tubes"]), one["tubes"][0][2]) for one in drawn["policies"]]
    levels = [100, 200, 300, 400]  # of 0.1 um
    assert found == [("feed 0", True, 3, levels), ("feed 1", False, 3, levels)]
    monkeypatch.setattr(profiles, "MAX_METRES", 20)  # of 24
    coarse = profiles.traces(table, grouped(metres), [], None)
    assert coarse["metres"] == [1.0, 3.0, 5.0]  # pairs from 0 on
    assert coarse["policies"][0]["tubes"][0][2] == [100, 255, 400]  # root mean square of 200 and 300


def test_short_schedule_has_the_rows_that_describe_it():
    """A step between 30 and 35 m and a corner of the air at 50 m, among 12 rows; of a law the mean that was driven."""
    length = np.arange(5.0, 61.0, 5.0)
    feed, air = np.where(length > 32.0, 0.2, 0.4), np.interp(length, [5.0, 50.0, 60.0], [0.02, 0.02, 0.03])
    mine = Schedule("inserted_length", "linear", tuple(length), tuple(feed), tuple(air))
    metres = [
        pd.DataFrame({"inserted_length": length, "feed_speed": feed + shift, "air_supply_rate": air - 0.1 * shift})
        for shift in (-0.01, 0.01)
    ]
    law = {}, "as driven, mean over the insertions"
    for described, note in ((Scheduled(CONFIG, mine).describe(), "linear between rows"), law):
        words, rows = profiles.short_schedule(described, pd.concat(metres))
        assert words == f"5 of 12 rows; {note}"
        assert rows["inserted_length"].tolist() == [5.0, 30.0, 35.0, 50.0, 60.0]
        for name, values in (("feed_speed", feed), ("air_supply_rate", air)):
            np.testing.assert_allclose(np.interp(length, rows["inserted_length"], rows[name]), values)
    assert profiles.short_schedule({}, metres[0][:0])[1].empty


def test_oracles_are_no_rivals():
    """However they are wrapped: a round trip, a shield around it."""
    for passes, names in (
        ("in", ["privileged", "pi", "planner", "shielded:privileged"]),
        ("both", ["privileged", "pi", "shielded:privileged"]),
    ):
        policies = named_policies(names, TaskConfig(passes=passes, privileged=True))
        record = SimpleNamespace(policies={name: policy.describe() for name, policy in policies.items()})
        assert oracle_policies(SimpleNamespace(record=record)) == {name.replace(":", "-") for name in names} - {"pi"}


@pytest.mark.filterwarnings("ignore:.*is the unit right")
def test_tubes_without_a_valid_start_are_refused(tmp_path, capsys):
    tube, output = tmp_path / "mine.toml", tmp_path / "out"
    for text, message in (
        ("[contact]\nstiffness = 200\n", "contact_stiffness = 200 N/m is below"),
        ("[air]\nair_supply_rates = [0.1, 0.15]\n", "drag pulls the probe with .* give fidelity = {'method'"),
        ("[tube]\nhelix_length = 4\n", "must not exceed tube.helix_length = 4 m"),
    ):
        tube.write_text(text)
        options = ["--tube", str(tube), "--limit", "1", "--fidelity", "fast", "--output", str(output)]
        assert main(["evaluate", "constant", *options]) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert re.search(rf"error: mine: .*{message}", said)
        assert "1 validation error" not in said
        assert not output.exists()


def test_passes_follow_the_tube_file_and_options(tmp_path, monkeypatch, capsys):
    tube, plans = tmp_path / "mine.toml", []
    tube.write_text('[task]\npasses = "both"\ninspects = "back"\ntime_limit = 1000.0\n')
    monkeypatch.setattr("probe_agents.evaluation.run.evaluate_plan", lambda plan, *rest: plans.append(plan))
    options = ["evaluate", "constant", "--limit", "1", "--fidelity", "fast"]
    for more in ([], ["--passes", "in"], ["--scored-pass", "insertion"], ["--passes", "both"]):
        assert main([*options, "--tube", str(tube), *more]) == 0
    assert [plan.config.passes for plan in plans] == ["both", "in", "both", "both"]
    assert [plan.config.scored_pass for plan in plans] == ["withdrawal", "withdrawal", "insertion", "withdrawal"]
    assert {plan.config.time_limit for plan in plans} == {1000.0}
    assert plans[0].fidelity == ROUND_TRIP_PRESETS["fast"]
    assert main([*options, "--scored-pass", "insertion"]) == 2
    assert "scored_pass = 'insertion' needs --passes both" in capsys.readouterr().err


def test_a_lone_schedule_is_compared_with_the_best_one(tmp_path, monkeypatch, capsys):
    calls, mine = [], tmp_path / "mine.csv"
    mine.write_text("inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.2,63\n")
    monkeypatch.setattr(
        "probe_agents.evaluation.run.evaluate_plan", lambda plan, out, against, *_: calls.append((plan, against))
    )
    options = ["--limit", "1", "--fidelity", "fast"]
    for policies, against in (
        ([f"a={mine}"], "best-schedule"),
        ([f"a={mine}", "--against", "a"], "a"),
        ([f"a={mine}", "pi"], None),
        (["pi"], None),
    ):
        assert main(["evaluate", *policies, *options]) == 0
        plan, reference = calls.pop()
        added = "pi" not in policies
        assert ("best-schedule" in plan.policies, reference) == (added, against)
        first = f"one schedule, a={mine}: best-schedule is added for comparison" if added else "evaluation of "
        assert capsys.readouterr().out.startswith(first)


def test_the_page_names_passes_and_strained_cables(stored):
    table = pd.read_parquet(stored / "episodes.parquet")
    table["cost_tension"] = np.where((table["policy"] == "feed 1") & (table["context"] > 0), 3.0, 0.0)
    table.to_parquet(stored / "episodes.parquet")
    manifest = stored / "manifest.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"files": {}}))
    page = write_report(stored).read_text()
    assert "<li>feed 1: the root was over the tension limit in 4 of 6 episodes, for 3 control periods at most<" in page
    assert "feed 0: the root" not in page
    assert "<dt>passes</dt>" not in page
    task = TaskConfig(passes="both", scored_pass="withdrawal").model_dump(mode="json")
    both = {"task": task, "fidelity": ROUND_TRIP_PRESETS["fast"].model_dump()}
    setting = stored / "setting.json"
    setting.write_text(json.dumps(json.loads(setting.read_text()) | both))
    facts = dict(re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", write_report(stored).read_text()))
    assert facts["passes"] == "in and back; scored is the withdrawal"
    assert (facts["simulated with"], facts["insertions"]) == ("fast", "12, of 2 policies in the same 3 tubes")


def test_insertions_that_ran_out_of_time_are_counted(evaluated, capsys):
    table = pd.read_parquet(evaluated / "episodes.parquet")
    table.loc[table["policy"] == "feed 1", ["complete", "lost_drive"]] = 0.0
    table.loc[(table["policy"] == "feed 1") & (table["context"] > 0), "lost_drive"] = 1.0
    print_summary(table, "feed 0")
    printed = capsys.readouterr().out
    assert "feed 1: 0 of 6 complete, 4 lost drive, 2 out of time\n" in printed
    assert "Means over 3 tubes with 95 % intervals, too few for exact ones" in " ".join(printed.split())


def test_no_interval_is_claimed_for_one_tube(tmp_path, capsys):
    evaluate_plan(make_plan(1, 1, seeds=(0,)), tmp_path)
    assert "95 %" not in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text()
    assert "<dd>1, of 1 policy in 1 tube</dd>" in page
    assert "95 %" not in re.sub("<s(tyle|cript).*?</s(tyle|cript)>", "", page, flags=re.DOTALL)
