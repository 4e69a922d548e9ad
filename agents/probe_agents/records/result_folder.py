"""The folder of a result: identity, lock, journals and manifest of a command that can be interrupted and continued."""

import hashlib
import json
import os
import re
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Generic, Self

from filelock import FileLock, Timeout
from pydantic import Field

from probe_agents.records.atomic import named
from probe_agents.records.manifest import commit, write_json, write_manifest
from probe_agents.records.models import RESTORE, S, Stored, read_json, validate
from probe_env.files import MEBI, FileError, as_text, open_regular

SETTING: Final = "setting.json"
MAX_JOURNAL: Final = 4096 * MEBI
MAX_HASHED: Final = 16384 * MEBI
MAX_VALUE: Final = 40
"""Maximum number of characters of a setting in an error."""
ADVICE: Final = "choose another folder or delete this one"
CHECKSUM: Final = re.compile(rb',\s?"crc":\s?"([0-9a-f]{8})"\}\s*$')
"""End of a line of a journal: CRC-32 of what is before it. Lines of other programs have none."""


class ResultFolder:
    """A folder of results with one identity; an interrupted command continues in it.

    The identity is what all records of a folder share: the commit of the code (without ``configs``) and common
    settings. It is stored in ``setting.json``; a folder of another identity is refused. What else a record depends on
    is hashed in its key, so that only changed records are simulated again:

    ========  ========================================================  ==============================
    command   identity, besides the commit of the code                  key of a record
    ========  ========================================================  ==============================
    evaluate  task, fidelity, probes, vibration map of the surrogate    policy, tube, seed
    study     as evaluate, one folder per setting                       as evaluate
    app       as evaluate                                               as evaluate
    compare   task, fidelity, sections or insertions, plant             design, tube, feed
    design    as compare, and variables, tubes, feed, seed              number of the trial
    train     training file but seeds and phases; plant, teacher, map   phase; one folder per seed
    ========  ========================================================  ==============================

    Tables of the built-in studies (``records.store``) have the commit in a column and their settings in the others.

    Args:
        path: the folder.
        identity: common settings, JSON-ready; version and commit of the code are added.
        made: what is stored, for errors: "these episodes were simulated".
        free: dotted names of fields that are stored but may differ.
        file: name of the file of the identity.

    Raises:
        FileError: the name of the folder is not UTF-8.
    """

    def __init__(
        self,
        path: Path,
        identity: Mapping[str, Any],
        made: str = "these episodes were simulated",
        free: Collection[str] = (),
        file: str = SETTING,
    ) -> None:
        try:
            os.fspath(path).encode()
        except UnicodeEncodeError as error:
            raise FileError(path, "the name of the folder is not UTF-8: choose another folder") from error
        self.path, self.file, self.made, self.free = path, path / file, made, frozenset(free)
        code = {"version": version("probe-env"), "commit": commit()}
        self.identity: dict[str, Any] = json.loads(json.dumps({**code, **identity}))

    def check(self, *records: str) -> dict[str, Any]:
        """Raise unless the folder has this identity or none; returns the stored one. Nothing is changed.

        Args:
            records: names of files that need the file of the identity next to them.

        Raises:
            FileError: another commit or another setting, or the file of the identity is damaged or missing.
        """
        if not self.file.exists():
            for name in records:
                if (self.path / name).exists():
                    raise FileError(self.file, f"missing next to {name}: {RESTORE}")
            return {}
        stored = read_json(self.file, Identity).model_dump(mode="json")
        for name in ("commit", "version"):
            before, now = stored[name], self.identity[name]
            if before != now:
                raise FileError(self.path, code_changed(self.made, name, before, now))
        before, now = (
            _fields({name: values.get(name) for name in self.identity}) for values in (stored, self.identity)
        )
        names = [name for name in dict.fromkeys((*now, *before)) if name not in self.free]
        changes = [name for name in names if before.get(name) != now.get(name)]
        if changes:
            first, *others = changes
            text = f"{first} {_short(before.get(first))}, now {_short(now.get(first))}"
            text += f"; also {', '.join(others[:5])}" if others else ""
            raise FileError(self.path, f"{self.made} with other settings ({text}): {ADVICE}")
        return stored

    @contextmanager
    def open(self, *records: str, **details: Any) -> Iterator[Self]:
        """Lock the folder, check the identity and store it, with ``details`` of a new one; raises as ``check``."""
        with run_lock(self.path):
            stored = self.check(*records)
            content = (stored or details) | self.identity
            if content != stored:
                write_json(self.file, content)
            yield self

    def write_manifest(self, *files: str, **settings: Any) -> None:
        """Write the manifest of these files and the identity, see ``manifest.write_manifest``."""
        write_manifest(self.path, (*files, self.file.name), **settings)


def code_changed(made: str, name: str, before: str, now: str) -> str:
    """Error for results of another commit or version (``name``) of the code."""
    return f"the code changed since {made} ({name} {before or 'unknown'}, now {now}): {ADVICE}"


class Identity(Stored):
    """The code in ``setting.json``; the other fields are those of the command."""

    version: str
    commit: str


class Hashes(Stored):
    """The files in ``manifest.json``."""

    files: dict[str, str] = Field(default_factory=dict)


def check_hashes(folder: Path, *names: str) -> None:
    """Raise FileError if a file is not the one of the manifest of its folder; files that it does not list pass."""
    manifest = folder / "manifest.json"
    hashes = read_json(manifest, Hashes).files if manifest.exists() else {}
    for name in names:
        if name in hashes and (folder / name).exists():
            with open_regular(folder / name, MAX_HASHED) as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != hashes[name]:  # type: ignore[arg-type]
                    problem = "its content is not what manifest.json says: it was changed after it was written"
                    raise FileError(folder / name, f"{problem} - restore it, or repeat the command")


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Lock a folder against a second process; the system releases the lock when the process ends.

    Raises:
        FileError: another process works there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / "lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise FileError(folder, "another process is working there: wait for it, or choose another folder") from error
    try:
        yield
    finally:
        lock.release()
        (folder / "lock").unlink(missing_ok=True)


def _fields(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of nested mappings by dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _fields(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= MAX_VALUE else "..."


def sealed(record: Mapping[str, Any], separators: tuple[str, str] | None = None) -> dict[str, Any]:
    """A record with its checksum as the last field: of its JSON text with these separators."""
    text = json.dumps(record, separators=separators)[:-1]
    return {**record, "crc": f"{zlib.crc32(text.encode()):08x}"}


def is_intact(line: bytes) -> bool:
    """Whether a line has its checksum, or none."""
    match = CHECKSUM.search(line)
    return match is None or zlib.crc32(line[: match.start()]) == int(match[1], 16)


class Journal(Generic[S]):
    """Records by key in a file of lines, each with a checksum and on the disk before the next one starts.

    Args:
        path: the file, which need not exist.
        model: model of a record, with a field ``key``.
    """

    def __init__(self, path: Path, model: type[S]) -> None:
        self.path, self.model = path, model

    def read(self) -> dict[str, dict[str, Any]]:
        """Records by key, the last one of each key; a last line without its end is incomplete and ignored.

        Raises:
            FileError: another line is not a record or not what was written; names file and line.
        """
        records: dict[str, dict[str, Any]] = {}
        for number, line in enumerate(self._lines(), start=1):
            if not is_intact(line):
                problem = "its checksum does not fit: it was changed after it was written"
                raise FileError(self.path, f"line {number}: {problem} - remove the line (its work is repeated)")
            text = as_text(self.path, line, number)
            record = validate(self.path, f"line {number}: ", text, self.model).model_dump(exclude_none=True)
            records[record["key"]] = record
        return records

    @contextmanager
    def appending(self) -> Iterator[Callable[..., None]]:
        """Context of a function that appends records; they are on the disk when it returns. The folder is locked."""
        if os.path.lexists(self.path):
            os.truncate(self.path, sum(map(len, self._lines())))
        with self.path.open("ab") as file:

            def append(*records: Mapping[str, Any]) -> None:
                with named(self.path):
                    file.write("".join(f"{json.dumps(sealed(record))}\n" for record in records).encode())
                    file.flush()
                    os.fsync(file.fileno())

            yield append

    def _lines(self) -> Iterator[bytes]:
        """The complete lines."""
        if os.path.lexists(self.path):
            with open_regular(self.path, MAX_JOURNAL) as file:
                yield from (line for line in file if line.endswith(b"\n"))
