"""Checked reading of stored files: bounded size first, then a model, named columns or expected arrays.

Every problem is a ``FileError`` of one line: ``FILE: place: problem - remedy``. Reading changes nothing.
"""

from agents.records.models import read_json
from agents.records.tables import check_table, read_csv, read_parquet
from probe_env.files import FileError

__all__ = ["FileError", "check_table", "read_csv", "read_json", "read_parquet"]
