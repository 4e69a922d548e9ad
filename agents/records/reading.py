"""Readers of stored files: JSON by models, CSV and Parquet by named columns. Every error is one line with the place."""

from agents.records.models import read_json
from agents.records.tables import check_table, read_csv, read_parquet
from probe_env.files import FileError

__all__ = ["FileError", "check_table", "read_csv", "read_json", "read_parquet"]
