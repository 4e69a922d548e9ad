"""Journals of searches: continued, damaged, and of another search."""

import shutil

import optuna
import pytest
from poisons import ANYWHERE

from agents.records.searches import open_study
from probe_env.files import FileError

SPACE = {"x": optuna.distributions.FloatDistribution(0.0, 1.0)}


@pytest.fixture
def journal(tmp_path):
    """Journal of a study with one complete trial."""
    path = tmp_path / "study.jsonl"
    study = open_study(path, "known", ["minimize"], ["x"])
    study.tell(study.ask(SPACE), 1.0)
    return path


def test_a_study_is_continued_without_what_a_kill_left_unfinished(journal):
    open_study(journal, "known", ["minimize"], ["x"]).ask(SPACE)
    with journal.open("ab") as file:
        file.write(b'{"op_code":6,"worker_id"')  # of a line that was cut off
    study = open_study(journal, "known", ["minimize"], ["x"])
    assert [trial.state.name for trial in study.get_trials()] == ["COMPLETE", "FAIL"]
    study.tell(study.ask(SPACE), 2.0)
    assert [trial.value for trial in open_study(journal, "known", ["minimize"], ["x"]).get_trials()] == [1.0, None, 2.0]


def test_a_study_of_another_search_is_refused(journal):
    for directions, parameters in ((["maximize"], ["x"]), (["minimize"] * 3, ["x"]), (["minimize"], ["y"])):
        with pytest.raises(FileError, match=r"study\.jsonl: .*study 'known' is of another search"):
            open_study(journal, "known", directions, parameters)


def test_damaged_journals_are_named_and_stay_as_they_are(journal):
    whole, failures = journal.read_bytes(), []
    damages = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "binary", "utf-16", "NUL")} | {
        "a line of something else": lambda path: path.write_bytes(b'{"a": 1}\n' + whole),
        "a line that is no JSON": lambda path: path.write_bytes(whole.replace(b'{"op_code"', b'"op_code"', 1)),
        "another kind of value": lambda path: path.write_bytes(whole.replace(b'"values":[1.0]', b'"values":["a"]')),
        "no study": lambda path: path.write_bytes(whole.split(b"\n", 1)[1]),
        "no state": lambda path: path.write_bytes(whole.replace(b'"state":1', b'"state":"b"')),
    }
    for name, damage in damages.items():
        damage(journal)
        before = journal.read_bytes() if journal.is_file() and journal.stat().st_size < 1 << 26 else None
        try:
            open_study(journal, "known", ["minimize"], ["x"])
            failures.append(name)
        except FileError as error:
            same = before is None or journal.read_bytes() == before
            failures += [] if same and str(journal) in str(error) and "\n" not in str(error) else [name]
        shutil.rmtree(journal) if journal.is_dir() else journal.unlink()
        journal.write_bytes(whole)
    assert failures == []
