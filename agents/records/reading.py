"""Reading what is on disk: one rule for every file, whoever wrote it.

A file must be a regular one of bounded size (``probe_env.files``), what it declares is summed up before memory is
taken, and what it holds is checked against a model (``records``), named columns (``tables``), the shapes that are
expected (``arrays``) or the search that it should hold (``database``). What does not fit raises a ``FileError``: one
line, ``FILE: place: what is wrong - what to do``. Reading changes nothing.
"""

from agents.records.models import read_json
from agents.records.tables import check_table, read_csv, read_parquet
from probe_env.files import FileError

__all__ = ["FileError", "check_table", "read_csv", "read_json", "read_parquet"]
