"""Damage that any file may have, by its name, as a function of the path; what tests of damaged files share."""

import hashlib
import os
from pathlib import Path

from probe_env.files import FileError

ROOT = Path(__file__).parents[1]
FAST = ["--fidelity", "fast", "--limit", "2"]


def fingerprint(folder):
    """Every path with what it holds."""
    files = {}
    for path in sorted(folder.rglob("*")):
        whole = path.is_file() and path.stat().st_size < 1 << 26
        files[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest() if whole else str(path.lstat().st_mode)
    return files


class Poison:
    """Unpickled, it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def fifo(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def folder_instead(path):
    path.unlink(missing_ok=True)
    path.mkdir()


def huge(path):
    with path.open("wb") as file:
        file.truncate(1 << 42)


ANYWHERE = {
    "pipe": fifo,
    "folder": folder_instead,
    "huge": huge,
    "empty": lambda path: path.write_bytes(b""),
    "binary": lambda path: path.write_bytes(bytes(range(256)) * 8),
    "utf-16": lambda path: path.write_text("{}", encoding="utf-16"),
    "NUL": lambda path: path.write_bytes(b"\0" * 512),
}
JSON = ANYWHERE | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "{}": lambda path: path.write_text("{}"),
    "a list": lambda path: path.write_text("[1]"),
    "nested": lambda path: path.write_text("[" * 100_000),
    "a number": lambda path: path.write_text("9" * 10_000),
}


def failures_of(path, damages, read, place=""):
    """Names of damages that are read, are refused without file and place in one line, or change files."""
    whole, failures = path.read_bytes(), []
    for name, damage in damages.items():
        damage(path)
        before = fingerprint(path.parent)
        try:
            read(path)
            failures.append((name, "is read"))
        except FileError as error:
            if not str(error).startswith(f"{path}: {place}") or not str(error).isprintable():
                failures.append((name, str(error)[:200]))
        if fingerprint(path.parent) != before:
            failures.append((name, "changes files"))
        path.rmdir() if path.is_dir() else path.unlink()
        path.write_bytes(whole)
    return failures
