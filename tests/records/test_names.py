"""Names of policies and files."""

from pathlib import Path

import pytest
from plans import CONFIG, make_plan

from probe_agents.cli import main
from probe_agents.evaluation.plan import run_plan
from probe_agents.evaluation.report import write_report
from probe_agents.evaluation.statistics import grouped
from probe_agents.policies.catalogue import name_and_spec, named_policies
from probe_agents.policies.fixed import Constant
from probe_agents.records.tables import read_csv
from probe_agents.terminal.tables import print_table
from probe_env.envs.task.config import TaskConfig

HEAD = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n"


def test_names_that_are_refused():
    for name in ("=1+1", "@SUM(A1)", "+1+1", "-1", "\tx", "a\x1b[31mb", "a\nb", "x" * 81, " x", "", "\u202ecsv"):
        with pytest.raises(ValueError, match=r"(?s)^policy .* NAME=FILE gives a name"):
            named_policies([f"{name}=constant"], TaskConfig())


def test_files_of_any_name(tmp_path, monkeypatch):
    """A file that is there wins over NAME=FILE; what a spreadsheet takes for a formula is left out of its name."""
    monkeypatch.chdir(tmp_path)
    for file in ("a=b.csv", "-x.csv", "=2.csv", "c@3.csv", "null.csv", "1e5.csv", "d=1/y=2.csv"):
        Path(file).parent.mkdir(exist_ok=True)
        Path(file).write_text(HEAD + "5,0.1,63\n")
    given = {
        "a=b.csv": ("a=b", "a=b.csv"), "./a=b.csv": ("a=b", "./a=b.csv"), "n=a=b.csv": ("n", "a=b.csv"),
        "n@1=a=b.csv": ("n@1", "a=b.csv"), "-x.csv": ("x", "-x.csv"), "./-x.csv": ("x", "./-x.csv"),
        "=2.csv": ("2", "=2.csv"), "c@3.csv": ("c@3", "c@3.csv"), "d=1/y=2.csv": ("y=2", "d=1/y=2.csv"),
        "m=d=1/y=2.csv": ("m", "d=1/y=2.csv"), "k=constant": ("k", "constant"), "p=q=pi": ("p=q", "pi"),
        "n=no.csv": ("n", "no.csv"), "null.csv": ("null", "null.csv"), "1e5.csv": ("1e5", "1e5.csv"),
    }  # fmt: skip
    assert {spec: name_and_spec(spec) for spec in given} == given
    assert list(named_policies(["a=b.csv", "./-x.csv", "n@1=d=1/y=2.csv"], TaskConfig())) == ["a=b", "x", "n@1"]


def test_options_end_where_the_user_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("-x.csv").write_text(HEAD + "5,0.1,63\n")
    for arguments in (["--limit", "99", "--", "-x.csv"], ["./-x.csv", "--limit", "99"]):
        assert main(["evaluate", *arguments]) == 2
        assert "limit = 99" in capsys.readouterr().err  # so the file was taken


def test_names_like_numbers_and_markup_are_kept(tmp_path, capsys):
    names = ["null", "1e5", "nan", "NA", "<b>x</b>", "[red]y", "$\\frac$", "_z", "v@²"]
    constants = {name: Constant(CONFIG, feed_speed=0.1 + 0.01 * k) for k, name in enumerate(names)}
    run_plan(make_plan(2, seeds=(0,), policies=constants), tmp_path, progress=False)
    table = read_csv(tmp_path / "episodes.csv", {"policy": "name"})
    assert list(dict.fromkeys(grouped(table)["policy"])) == names
    page = write_report(tmp_path).read_text()
    assert "<b>x" not in page
    assert "&lt;b&gt;x" in page
    assert list(dict.fromkeys(read_csv(tmp_path / "summary.csv", {"policy": "name"})["policy"])) == names
    print_table("[red]title", ["policy"], [[name] for name in names])
    assert "[red]y" in capsys.readouterr().out
