"""Damaged databases of searches, and passwords in their addresses."""

import contextlib
import json
import sqlite3
import sys

import pytest
from poisons import ANYWHERE

from probe_env.files import FileError


def other_database(path):
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE accounts (name TEXT)")
    connection.close()


def damaged_database(path):
    other_database(path)
    content = bytearray(path.read_bytes())
    content[100:] = b"\xff" * (len(content) - 100)
    path.write_bytes(content)


DATABASES = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "binary", "NUL")} | {
    "another's": other_database,
    "damaged": damaged_database,
    "cut off": lambda path: path.write_bytes(b"SQLite format 3\0"),
}


@pytest.mark.parametrize("damage", DATABASES)
@pytest.mark.parametrize("given", [False, True])
def test_databases(damage, given, tmp_path, refused):
    output = tmp_path / "design"
    output.mkdir()
    DATABASES[damage](output / "study.db")
    storage = ["--storage", f"sqlite:///{output / 'study.db'}"] if given else []
    refused(["design", "--output", output, *storage], str(output / "study.db"))


def test_a_locked_database(tmp_path, refused, monkeypatch):
    monkeypatch.setattr("agents.searches.database.PATIENCE", 0.1)
    output = tmp_path / "design"
    output.mkdir()
    holder = sqlite3.connect(output / "study.db", isolation_level=None)
    holder.execute("CREATE TABLE studies (name TEXT)")
    holder.execute("BEGIN EXCLUSIVE")
    error = refused(["design", "--output", output], f"{output / 'study.db'}: locked by another process")
    assert len(error) < 400
    holder.close()


CELLS = {
    "distribution": "UPDATE trial_params SET distribution_json = '[]'",
    "parameter of text": "UPDATE trial_params SET param_value = 'abc'",
    "parameter of NULL": "UPDATE trial_params SET param_value = NULL",
    "parameter out of range": "UPDATE trial_params SET param_value = 1e9",
    "objective of text": "UPDATE trial_values SET value = 'abc'",
    "kind of objective": "UPDATE trial_values SET value_type = 'FOO'",
    "state": "UPDATE trials SET state = 'FOO'",
    "commit": "UPDATE trial_user_attributes SET value_json = '[1, 2]'",
    "attribute that is no JSON": "UPDATE trial_user_attributes SET value_json = '{'",
    "table": "DROP TABLE trials",
}


@pytest.mark.parametrize("damage", CELLS)
def test_a_whole_database_with_damaged_cells(damage, tmp_path):
    """Nothing is changed, and the error is one line that names the file."""
    import optuna

    from agents.searches.database import open_study

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = tmp_path / "study.db"
    study = open_study(f"sqlite:///{path}", "known", ["minimize"], ["x"])
    trial = study.ask({"x": optuna.distributions.FloatDistribution(0.0, 1.0)})
    trial.set_user_attr("commit", "0123456789ab")
    study.tell(trial, 1.0)
    with contextlib.closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute(CELLS[damage])
    before = path.read_bytes()
    with pytest.raises(FileError, match=r"study\.db: ") as error:
        open_study(f"sqlite:///{path}", "known", ["minimize"], ["x"])
    assert len(str(error.value)) < 600
    assert "\n" not in str(error.value)
    assert path.read_bytes() == before


def test_a_study_of_another_search(tmp_path):
    import optuna

    from agents.searches.database import open_study

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    storage = f"sqlite:///{tmp_path / 'study.db'}"
    study = open_study(storage, "known", ["minimize"], ["x"])
    study.tell(study.ask({"x": optuna.distributions.FloatDistribution(0.0, 1.0)}), 1.0)
    assert len(open_study(storage, "known", ["minimize"], ["x"]).trials) == 1
    for directions, parameters in ((["maximize"], ["x"]), (["minimize"] * 3, ["x"]), (["minimize"], ["y"])):
        with pytest.raises(FileError, match=r"study\.db: study 'known' is of another search"):
            open_study(storage, "known", directions, parameters)


@pytest.mark.parametrize(
    "storage",
    [
        "postgresql://me:se:cr@et@nowhere.invalid/db",
        "mysql://me:secret@nowhere.invalid/db",
        "nodriver://me:secret@nowhere.invalid/db",
        "redis://:secret@nowhere.invalid",
        "postgresql://nowhere.invalid/db?user=me&password=secret",
        "postgresql://me:secret@nowhere.invalid:port/db",
    ],
)
def test_passwords_are_neither_told_nor_stored(storage, tmp_path, refused, monkeypatch):
    from agents.records.provenance import provenance

    error = refused(["design", "--storage", storage, "--output", tmp_path / "out"], "storage = ", "***")
    monkeypatch.setattr(sys, "argv", ["probe-env", "design", "--storage", storage, f"--storage={storage}"])
    for text in (error, json.dumps(provenance())):
        assert "se:cr" not in text
        assert "secret" not in text
        assert "***" in text
