"""What commands refuse: one line that says why, status 2, nothing simulated and nothing written."""

import shutil
from pathlib import Path

import pytest

from probe_agents.cli import main

ROOT = Path(__file__).parents[2]
FILES = {
    "both.toml": '[task]\npasses = "both"\n',
    "empty.toml": "",
    "rig.csv": "time_s,inserted_length_m,air_supply_m3_per_h\n0,5,63\n1,5.2,63\n2,5.4,63\n",
    "own.csv": "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n5,0.3,63\n",
    "instrument.toml": "[instrument]\ntest_frequency = 100.0\n",
}
"""Files in the working folder, with the folder configs of the checkout."""
REFUSED = [
    ("simulat", "no command 'simulat': did you mean simulate?"),
    ("zzz", "no command 'zzz': the commands are simulate, evaluate"),
    ("evaluate --limi 3", "Unrecognized options: --limi, 3; Perhaps you meant: --limit INT"),
    ("evaluate --zzzz", "Unrecognized options: --zzzz"),
    ("evaluate --limit x", "Error parsing --limit: 'x' is not a whole number"),
    ("evaluate pi --limit", "Missing value for argument '--limit'. Expected 1 values."),
    ("evaluate --contexts tset", "invalid choice 'tset' for argument '--contexts'. Expected one of ('train', "),
    ("simulate", "Missing from probe-env simulate: SCENE Scene file (TOML)"),
    ("simulate fig11_l10 fig11_l20", "Unrecognized options: fig11_l20"),
    ("simulate fig11_l10 --scene.air.drag 1", "Perhaps you meant: --scene.air.drag-coefficient"),
    ("simulate fig11_l10 --scene.contact.friction 1.2", "--scene.contact.friction: 1.2 is outside the accepted range"),
    ("simulate nowhere.toml", "no such file: nowhere.toml"),
    ("simulate configs/schedules/example.csv", "is not a TOML file (.toml)"),
    ("simulate fig11_l10 --duration -1", "duration = -1.0 s is outside the accepted range 0.001 to 100000 s"),
    ("simulate configs", "configs: a folder, not a file - shipped scenes"),
    ("simulate fig11_l10 --nodes-per-pitch 0", "nodes_per_pitch = 0"),
    (
        "evaluate constant --passes both --fidelity reference",
        "fidelity = 'reference': superelement does not simulate withdrawal; give one of standard, fast, study",
    ),
    ("evaluate constant --limit 1 --output rig.csv", "rig.csv: a file, where a"),
    ("evaluate a\x1b[31mb=constant --limit 2", "NAME=FILE gives a name"),
    ("render --output film.avi", "'film.avi' must end in one of .gif, .mp4, .png"),
    ("render --every 0", "every = 0"),
    ("render --at 45", "at = 45.0 m needs --view strip"),
    ("render --view strip --at 60", "at = 60.0 m is outside the accepted range 5 m (the start) to less than 60 m"),
    ("render --view strip --at 46 --tube example", "to less than 45 m"),
    ("render --view strip --at nan", "at = nan m"),
    ("render --view strip --at 30 --env-id probe_env/Snapshot-v1", "at = 30.0 m needs a growing insertion"),
    ("render --view strip --length 2", "length = 2.0 m is outside the accepted range 2.5 to 1000 m"),
    ("render --view strip --duration 2.5", "duration = 2.5 s is outside the accepted range 0.005 to 2 s"),
    ("render --view strip --duration 0.1005", "duration = 0.1005 s is not a whole number"),
    ("render --view strip --policy fastest", "unknown policy 'fastest'"),
    ("log rig.csv --output rig.txt", "output = 'rig.txt' is not a CSV file"),
    ("log rig.csv --plot rig.exe", "plot = 'rig.exe' is not a picture"),
    ("log nowhere.csv", "shipped logs: example-rig"),
    ("log example-rig --gap 0", "gap = 0.0 s is outside the accepted range 0.001 to 3600 s"),
    ("log example-rig --air-supply nan", "air_supply = nan m3/h is outside the accepted range"),
    (
        "log rig.csv --tube empty.toml",
        "empty.toml: instrument: missing, so the log cannot be judged: add the table [instrument]",
    ),
    ("log rig.csv --tube instrument.toml --output -", "tube: the metres to repeat are files next to --output, which"),
    ("recommend --output my.txt", "output = 'my.txt' is not a CSV file"),
    ("recommend --policy my.txt", "policy = 'my.txt' is not a JSON file"),
    ("recommend nowhere.csv", "no such file: nowhere.csv"),
    ("recommend own.csv --no-simulated", "schedules need the simulation"),
    ("recommend --limit 100", "limit = 100 is outside the accepted range 0 (all) to 48"),
    ("recommend --fidelity fine", "fidelity = 'fine' is not one of"),
    ("recommend --tube nowhere.toml", "no such file: nowhere.toml"),
    ("recommend --find a50=20", "find = 'a50=20' is not a90=PERCENT"),
    ("recommend --find a90=20 --no-simulated", "find needs the simulation"),
    ("recommend --find a90=20 --policy law.json", "policy = 'law.json': there is no law for a target"),
    ("recommend --find a90=20 --fidelity surrogate", "fidelity = 'surrogate' has no signal"),
    ("recommend --find a90=20 --tube both.toml", "task.passes = 'both': --find is for the insertion alone"),
    ("study robustnes", "robustness"),
    ("study --no-list", "study --list"),
    ("study plants --trials 3", "trials = 3"),
    ("study response --trials 3", "trials = 3: this study"),
    ("study plants --assumptions whole", "assumptions = 'whole': this study"),
    ("study response --assumptions whole", "assumptions = whole: this study"),
    ("study stability --fidelity fast", "fidelity = fast"),
    ("study claims --trials 0", "trials = 0 is outside the accepted range 1 to 1000"),
    ("study plc-constants --limit 97", "limit = 97 is outside the accepted range 1 to 96"),
    ("study best-schedules --trials 0", "trials = 0 is outside"),
    ("study vibration-map --trials 0", "trials = 0 is outside"),
    ("study learning --limit 49", "limit = 49 is outside"),
    ("study plc-constants --limit 0", "limit = 0 is outside"),
    ("study response --limit 0", "limit = 0 is outside"),
    ("signal constant --flaws 30", "flaws: '30' is not POSITION:DEPTH"),
    ("signal constant --flaws 70:20", "flaws: position of '70:20' = 70.0 m is outside the accepted range 0 to 60 m"),
    ("signal constant --flaws 30:200", "flaws: depth of '30:200' = 200.0 % is outside the accepted range 0.1 to 100 %"),
    ("signal constant --context 48", "context = 48 is outside the accepted range 0 to 47"),
    ("signal constant --until 70", "until = 70.0 m is outside the accepted range 5 to 60 m"),
    ("design --limit -1", "limit = -1 is outside the accepted range 0 (all) to 96"),
    ("design --contexts validation --limit 25", "limit = 25 is outside the accepted range"),
    ("design --trials 1", "trials = 1 is outside the accepted range 2 to 1e+06"),
    ("design --seed -1", "seed = -1 is outside the accepted range 0 to"),
    ("design --full", "feed = 'best-constant' needs sections"),
    ("design --full --feed fastest", "unknown policy 'fastest'"),
    ("design --feed constant --fidelity finest", "fidelity = 'finest' is not one of"),
    ("design --feed pi", "feed = 'pi' is not a schedule over inserted length"),
    ("compare nowhere.toml", "no such file: nowhere.toml"),
    ("compare original --limit 99", "limit = 99 is outside the accepted range"),
    ("compare original original", "same name"),
    ("plc --integral --csv law.csv", "integral = True needs --st"),
    ("app --origin http://localhost --no-show", "origin = 'http://localhost' is not host:port"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED)
def test_refused_commands(arguments, message, refused, tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    shutil.copytree(ROOT / "configs" / "schedules", tmp_path / "configs" / "schedules")
    monkeypatch.setenv("COLUMNS", "60")  # the narrowest in which tyro's box is still read whole
    monkeypatch.setattr("probe_env.envs.episodes.Episodes.reset", lambda *_: pytest.fail("simulated"))
    refused(arguments.split(), message)


@pytest.mark.filterwarnings("ignore:time_step = 0.001 s is beyond the known stable limit")  # and then it diverges
@pytest.mark.parametrize(
    ("option", "message"), [("--statistics-from=2", "statistics_from = 2.0"), ("--time-step=0.001", "diverged at t = ")]
)
def test_simulations_that_fail_write_nothing(option, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "fig11_l10", "--duration", "1", option]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
