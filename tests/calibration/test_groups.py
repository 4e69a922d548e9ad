"""Groups of simulated tubes: kept, gone on with, never mixed, and what is damaged is told before any work."""

import os

import pandas as pd
import pytest

from agents.calibration.simulated.groups import run_groups
from agents.processes.workers import Workers
from agents.records.provenance import commit
from probe_env.files import FileError

COLUMNS = {"reward": "number"}


def rows(group):
    return [[{"group": group, "tube": k, "reward": group + 0.5 * k} for k in range(2)]]


def run(folder, make=rows, count=3, fidelity="fast"):
    return run_groups(make, count, fidelity, folder, COLUMNS, Workers(1), "groups")


def test_what_was_interrupted_goes_on(tmp_path):
    def interrupted(group):
        if group == 1:
            raise KeyboardInterrupt
        return rows(group)

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, interrupted)
    done = (tmp_path / "group-0.csv").read_text()
    table = run(tmp_path, lambda group: rows(group) if group else pytest.fail("a stored group was made again"))
    assert (tmp_path / "group-0.csv").read_text() == done
    assert table["reward"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert set(table["fidelity"]) == {"fast"}
    assert set(table["commit"]) == {commit()}


def test_groups_of_before_rows_knew_their_commit_go_on(tmp_path):
    run(tmp_path, count=2)
    first = tmp_path / "group-0.csv"
    older = pd.read_csv(first).drop(columns="commit")
    first.write_text(older.to_csv(index=False))
    table = run(tmp_path)
    assert first.read_text() == older.to_csv(index=False)
    assert table["commit"].tolist() == [""] * len(older) + [commit()] * (len(table) - len(older))


def test_other_fidelities_are_not_mixed(tmp_path):
    run(tmp_path, count=1)
    with pytest.raises(FileError, match=r"group-0\.csv: is of fidelity = 'fast', not 'standard': choose another"):
        run(tmp_path, lambda group: pytest.fail("something was simulated"), fidelity="standard")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("group,tube\n0,0\n", "column"),
        ("group,tube,reward,fidelity,commit\n0,0,loud,fast,0123456789ab\n", "line 2: reward = 'loud' is not a number"),
        ("group,tube,reward,fidelity,commit\n0,0\n", "line 2: 2 values for 5 columns"),
        (None, r"group-2\.csv"),
    ],
)
def test_what_is_damaged_is_told_before_any_work(tmp_path, text, said):
    path = tmp_path / "group-2.csv"
    os.mkfifo(path) if text is None else path.write_text(text)
    with pytest.raises((FileError, OSError), match=said):
        run(tmp_path, lambda group: pytest.fail("something was simulated"))
    assert sorted(tmp_path.iterdir()) == [path]
