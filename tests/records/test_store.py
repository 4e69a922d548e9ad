"""Tables that grow row by row: nothing stored is dropped, and what other code made does not count."""

import pandas as pd
import pytest

from agents.records import store as module
from agents.records.store import Store, stored_rows
from agents.study import cases as study


def open_with(path, code):
    return Store(path, ("method", "k"), lambda _: code)


@pytest.fixture
def path(tmp_path):
    store = open_with(tmp_path / "rows.csv", "old")
    store.add({"method": "imex", "k": 1, "value": 2.0}, {"method": "newmark", "k": 1, "value": 3.0})
    store.add({"method": "imex", "k": 2, "value": 4.0})
    return store.path


def test_rows_of_other_code_do_not_count_and_stay(path):
    before = path.read_bytes()
    store = open_with(path, "new")
    assert not store.has("imex", 1)
    assert store.table.empty
    assert path.read_bytes() == before  # opening changes nothing
    store.add({"method": "imex", "k": 1, "value": 5.0})
    assert store.has("imex", 1)
    everything = pd.read_csv(path)
    assert len(everything) == 4
    assert everything["value"].tolist() == [2.0, 3.0, 4.0, 5.0]
    assert everything["superseded"].tolist() == [True, False, False, False]
    assert everything["code"].tolist() == ["old", "old", "old", "new"]
    assert stored_rows(path)["value"].tolist() == [3.0, 4.0, 5.0]
    assert open_with(path, "new").table["value"].tolist() == [5.0]


def test_rows_of_the_present_code_are_found_again_and_may_be_replaced(path):
    store = open_with(path, "old")
    assert store.has("imex", 1)
    assert not store.has("imex", 3)
    store.add({"method": "imex", "k": 2, "value": 6.0})
    assert open_with(path, "old").table["value"].tolist() == [2.0, 3.0, 6.0]


def test_every_row_knows_its_commit_and_the_table_names_them(tmp_path, monkeypatch):
    for number, name in enumerate(("aaa", "bbb")):
        monkeypatch.setattr(module, "commit", lambda name=name: name)
        open_with(tmp_path / "rows.csv", "code").add({"method": "imex", "k": number})
    assert stored_rows(tmp_path / "rows.csv")["commit"].tolist() == ["aaa", "bbb"]
    assert '"commit": "aaa, bbb"' in (tmp_path / "rows-provenance.json").read_text()


def test_a_table_of_another_kind_is_refused(tmp_path):
    (tmp_path / "rows.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match=r"rows\.csv: column .code. is missing"):
        open_with(tmp_path / "rows.csv", "code")
    assert (tmp_path / "rows.csv").read_text() == "a,b\n1,2\n"


def test_a_study_of_another_duration_leaves_the_first_where_it_is(tmp_path, monkeypatch):
    """It once dropped all rows of other durations: four of eight seconds became one of four."""

    def row(case, _, member, duration):
        return {"case": case.name, "member": member, "duration_s": duration, "radial_rms_m": 1e-4}

    monkeypatch.setattr(study, "run_case", row)
    first = study.run_study(tmp_path, tmp_path, 4, 8.0, ("l10",))
    second = study.run_study(tmp_path, tmp_path, 1, 4.0, ("l10",))
    assert (len(first), len(second)) == (4, 1)
    assert len(stored_rows(tmp_path / "ensemble.csv")) == 5
    repeated = study.run_study(tmp_path, tmp_path, 4, 8.0, ("l10",))
    pd.testing.assert_frame_equal(repeated, first, check_dtype=False)
    assert len(study.load_rows(tmp_path)) == 4
