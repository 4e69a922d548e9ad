"""Damage that any file may have, by its name, as a function of the path; what tests of damaged files share."""

import hashlib
import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
POLICIES = ("constant", "slow")
FAST = ["--fidelity", "fast", "--limit", "2"]
KPIS = (
    "inspection_time_s", "inspected_m", "inspected_share", "share_within_limit", "air_m3", "reward",
    "lost_drive_events", "lost_drive", "diverged", "complete", "radial_rms_m", "radial_p99_m", "radial_max_m",
    "radial_acceleration_rms_m_per_s2", "radial_acceleration_p99_m_per_s2", "radial_acceleration_max_m_per_s2",
)  # fmt: skip


def fingerprint(folder):
    """Every path with what it holds."""
    files = {}
    for path in sorted(folder.rglob("*")):
        whole = path.is_file() and path.stat().st_size < 1 << 26
        files[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest() if whole else str(path.lstat().st_mode)
    return files


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
