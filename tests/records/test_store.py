"""Tables that grow row by row, of one commit."""

import pandas as pd
import pytest

from probe_agents.records import store as module
from probe_agents.records.store import Store, stored_rows


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "commit", lambda: "aaa")
    store = Store(tmp_path / "rows.csv", ("method", "k"))
    store.add({"method": "imex", "k": 1, "value": 2.0}, {"method": "newmark", "k": 1, "value": 3.0})
    store.add({"method": "imex", "k": 2, "value": 4.0})
    return store.path


def test_rows_are_found_again_and_may_be_replaced(path):
    store = Store(path, ("method", "k"))
    assert store.has("imex", 1)
    assert not store.has("imex", 3)
    store.add({"method": "imex", "k": 2, "value": 6.0})
    assert Store(path, ("method", "k")).table["value"].tolist() == [2.0, 3.0, 6.0]
    assert stored_rows(path)["commit"].tolist() == ["aaa"] * 3


def test_a_time_step_that_is_no_short_decimal_is_found_again(tmp_path):
    runs = {(1e-3 / steps,): {"time_step_s": 1e-3 / steps} for steps in (7, 4)}
    for left in (2, 0):
        ran = []
        Store(tmp_path / "rows.csv", ("time_step_s",)).fill(runs, lambda run, ran=ran: ran.append(run) or [run])
        assert len(ran) == left


def test_rows_of_another_commit_are_refused_and_stay(path, monkeypatch):
    before = path.read_bytes()
    monkeypatch.setattr(module, "commit", lambda: "bbb")
    with pytest.raises(ValueError, match=r"the code changed since these rows were simulated \(commit aaa, now bbb"):
        Store(path, ("method", "k"))
    assert path.read_bytes() == before
    assert stored_rows(path)["value"].tolist() == [2.0, 3.0, 4.0]


def test_rows_outside_a_checkout_are_of_the_version(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "commit", lambda: "unknown")
    Store(tmp_path / "rows.csv", ("k",)).add({"k": 1})
    assert pd.read_csv(tmp_path / "rows.csv")["commit"][0].startswith("version ")
    assert Store(tmp_path / "rows.csv", ("k",)).has(1)


def test_a_table_of_another_kind_is_refused(tmp_path):
    for text, message in (("a,b\n1,2\n", "column .commit. is missing"), ("a,commit\n1,x\n", "no column k")):
        (tmp_path / "rows.csv").write_text(text)
        with pytest.raises(ValueError, match=rf"rows\.csv: {message}"):
            Store(tmp_path / "rows.csv", ("k",))
        assert (tmp_path / "rows.csv").read_text() == text
