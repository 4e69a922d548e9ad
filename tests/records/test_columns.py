"""One list of KPIs, and tables that were stored before there was one of them."""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.design.compare import cells, header, read_comparison, summarise
from agents.evaluation import passes
from agents.evaluation.report import kpi_cells
from agents.records import columns, tables
from agents.records.columns import CORE, HIGH, KPIS, OF_DESIGNS, kpis_of
from agents.records.tables import read_episodes
from probe_env.files import FileError

ROOT = Path(__file__).parents[2]
STORED = ROOT / "results" / "evaluation" / "episodes.csv"


@pytest.fixture
def newer(monkeypatch):
    """One more KPI, as an entry of the list gives it."""
    monkeypatch.setitem(columns.KPIS, "jolts_per_m", ("jolts", 1.0, "1/m"))
    monkeypatch.setitem(tables.EPISODES_NEWER, "jolts_per_m", "number")
    return "jolts_per_m"


def test_a_table_without_a_new_kpi_is_read_and_shown(newer):
    table = read_episodes(STORED)
    assert newer not in kpis_of(table.columns)
    over_tubes = 1  # a90/95, of the curves of detection
    assert len(kpi_cells(table)[0][1]) == len(set(KPIS) & set(table.columns)) + over_tubes


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_with_a_new_kpi_shows_it_and_is_checked(kind, newer, tmp_path):
    path, table = tmp_path / f"episodes.{kind}", pd.read_csv(STORED).assign(**{newer: 2.0})
    write = table.to_csv if kind == "csv" else table.to_parquet
    write(path, index=False)
    cell_rows = kpi_cells(read_episodes(path))
    assert all("2" in row for _, row in cell_rows)  # of no width, and so without an interval
    table = table.assign(**{newer: np.where(table.index == 3, np.nan, 2.0)})
    write = partial(table.to_csv, na_rep="nan") if kind == "csv" else table.to_parquet
    write(path, index=False)
    with pytest.raises(FileError, match=f"row 4: {newer} = nan is not finite"):
        read_episodes(path)


@pytest.mark.parametrize("name", CORE)
def test_the_core_is_demanded(name, tmp_path):
    pd.read_csv(STORED).drop(columns=name).to_csv(tmp_path / "episodes.csv", index=False)
    with pytest.raises(FileError, match=f"column '{name}' is missing"):
        read_episodes(tmp_path / "episodes.csv")


def test_designs_that_were_compared_before_there_was_a_kpi(tmp_path):
    whole = read_comparison(ROOT / "results" / "design" / "confirmed")
    assert kpis_of(whole.columns, OF_DESIGNS) == OF_DESIGNS
    whole.drop(columns="drive_margin_n").to_csv(tmp_path / "designs.csv", index=False)
    summary = summarise(read_comparison(tmp_path))
    assert header(summary) == [name for name in header(summarise(whole)) if "drive margin" not in name]
    assert {len(row) for row in cells(summary)} == {len(header(summary))}


def test_other_lists_choose_from_the_one():
    assert set(CORE) | set(HIGH) <= set(KPIS)
    assert {name: factor for name, (_, factor, _) in KPIS.items() if name in passes.KPIS} == passes.KPIS


def test_a_hash_of_decimal_digits_is_text(tmp_path):
    (tmp_path / "table.csv").write_text("commit,code,value\n075498296950,12345e678901,075\n")
    row = tables.read_csv(tmp_path / "table.csv").iloc[0]
    assert (row["commit"], row["code"], row["value"]) == ("075498296950", "12345e678901", 75)
