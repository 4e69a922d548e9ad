"""Record what user commands print and store, and compare two checkouts bit by bit on one machine.

    python tests/golden/compare.py record CHECKOUT FOLDER [CASE ...]    run the cases with the code of CHECKOUT
    python tests/golden/compare.py diff FOLDER FOLDER [CASE ...]        print what differs; exit 1 if anything does
    python tests/golden/compare.py checkouts A B [CASE ...]             record both in a temporary folder, then diff

A case runs in FOLDER/CASE, where its files stay; FOLDER/CASE.json holds its texts and tables as columns of strings, in
which every float has all its digits. CASE may be a pattern such as 'evaluate*'.
"""

import argparse
import contextlib
import fnmatch
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

INPUTS = Path(__file__).parent / "inputs"
Record = dict[str, dict[str, list[str]]]
"""Columns of each text and table: {file: {column: cells}}."""

# A case is one or more commands, run in turn until one fails. "A || B" takes B where A is refused (a renamed command).
# Files of inputs/ lie in the working directory.
CASES: dict[str, tuple[str, ...]] = {
    "simulate-newmark": ("simulate fig11_l10 --method newmark --duration 1 --output out",),
    "simulate-imex": ("simulate fig11_l20 --method imex --duration 1 --scene.contact.friction 0.2 --output out",),
    "simulate-superelement": ("simulate fig11_l30 --method superelement --duration 1 --output out",),
    "simulate-withdrawal": (
        "simulate fig11_l10 --method imex --duration 1 --start outer --scene.feed-speed -0.2"
        " --scene.air-supply-rate -0.0175 --scene.couple tangent --output out",
    ),
    "evaluate-fixed": (
        "evaluate constant pi best-schedule own.csv --limit 2 --fidelity fast --output out",
        "evaluate out || report out",
    ),
    "evaluate-laws": ("evaluate adaptive plc-integral plc-proportional --limit 2 --fidelity fast --output out",),
    "evaluate-agents": ("evaluate student ppo shielded:ppo --limit 2 --fidelity fast --output out",),
    "evaluate-planner": ("evaluate planner --tube longer.toml --limit 1 --fidelity fast --output out",),
    "evaluate-tube": ("evaluate pi plc-integral --tube tube.toml --limit 2 --fidelity fast --output out",),
    "evaluate-both-ways": (
        "evaluate fast-in own.csv --passes both --tube longer.toml --limit 1 --fidelity fast --output out",
    ),
    "evaluate-random-probes": ("evaluate adaptive pi --probes random --limit 2 --fidelity fast --output out",),
    "evaluate-standard": ("evaluate pi --tube longer.toml --limit 1 --fidelity standard --output out",),
    "signal": ("signal best-schedule --fidelity standard --flaws 5.5:20 6.5:60 --until 10 --output out",),
    "compare": ("compare original improved --limit 2 --fidelity standard --output out",),
    "compare-full": ("compare original improved --full --limit 1 --fidelity fast --output out",),
    "design": ("design --trials 5 --limit 2 --fidelity standard --output out",),
    "train": ("train train.toml --output out",),
    "log": ("log rig.csv --output out/clean.csv --plot out/rig.png",),
    "calibrate": ("calibrate rig.csv --output out",),
    "recommend": ("recommend own.csv --limit 1 --fidelity fast --policy out/law.json --output out/mine.csv",),
    "plc": ("plc --st out/law.st --csv out/law.csv", "plc --integral --st out/integral.st --tube tube.toml"),
    "render": ("render --policy pi --fidelity fast --output out/insertion.png",),
    "render-strip": ("render --view strip --fidelity standard --at 20 --duration 0.1 --output out/strip.png",),
    "agents": ("agents",),
    "steps-insertion": ("steps Insertion-v1 50 fidelity=fast contexts=test",),
    "steps-insertion-standard": ("steps Insertion-v1 20 probes=random fidelity=standard",),
    "steps-complete": ("steps Insertion-v1 60 fidelity=fast tube=short.toml",),
    "steps-time-limit": ("steps Inspection-v0 20 fidelity=fast config.time_limit=14",),
    "steps-snapshot": ("steps Snapshot-v1 50 fidelity=standard",),
    "steps-inspection": ("steps Inspection-v0 50 fidelity=fast contexts=test",),
    "steps-design": ("steps Design-v1 2 fidelity=standard",),
}
KINDS = {"single": 1, "make_vec": 4, "ProbeVecEnv": 4}
"""How `steps` makes an environment, and how many of it."""

IGNORED_FILES = re.compile(
    r"(provenance|manifest|run)\.json$|\.(jsonl|db|pt|zip|log|lock|npy)$|journal|tfevents|__pycache__"
)
IGNORED_NAMES = re.compile(
    r"(^|[._])(commit|code|code_hash|superseded|version|command|origin|machine|processor|python|packages|wall\w*|validation_s|kernel_s|seconds"
    r"|\w*_seconds|started|finished|date|created|files?|path|bundle|time/\w+)($|[._])"
)
"""Columns and keys that say where and when something was computed. Stored seconds are wall clock: times of the
simulation have the ending _s."""
UNKNOWN = re.compile(r"(policy|command|env_id|fidelity) = .* is not one of|no such file|no option|no environment")
PROGRESS = re.compile(r".*(%\||\[\d\d:\d\d|compiling kernels).*\n?|^\s*\n", re.MULTILINE)
TIMED, WALL_CLOCK = {"train"}, re.compile(r"│ +[\d.e+]+ │$", re.MULTILINE)
"""Cases whose printed table ends with a column of wall clock."""
TEXTS = re.compile(r"std(out|err) |\S+\.(html|png|gif|st),")
SHOWN = 3


def record(checkout: Path, folder: Path, names: list[str]) -> None:
    """Run the named cases with the code of the checkout, two at a time."""
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(2) as pool:
        for line in pool.map(lambda name: run(name, checkout.resolve(), folder.resolve()), names):
            print(line, flush=True)


def run(name: str, checkout: Path, folder: Path) -> str:
    """Run a case, write its record and return a line about it."""
    place, environment = folder / name, os.environ | {
        "PYTHONPATH": f"{checkout}{os.pathsep}{checkout / 'agents'}", "PYTHONHASHSEED": "0",
        "MPLBACKEND": "Agg", "COLUMNS": "200", "TERM": "dumb",
        "NO_COLOR": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1",
    }  # fmt: skip
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(INPUTS, place)
    (place / "out").mkdir()
    start, stored = time.time(), {}
    for number, line in enumerate(CASES[name]):
        for alternative in line.split(" || "):
            words = alternative.split()
            package = package_of(checkout)
            program = [__file__] if words[0] == "steps" else ["-m", f"{package}.cli"]
            done = subprocess.run(
                [sys.executable, *program, *words], cwd=place, env=environment, capture_output=True, text=True
            )
            if done.returncode == 0:
                break
        printed = WALL_CLOCK.sub("│ TIME │", done.stdout) if name in TIMED else done.stdout
        texts = (printed, PROGRESS.sub("", done.stderr))
        for stream, text in zip(("stdout", "stderr"), texts, strict=True):
            clean = text.replace(str(place), "PLACE").replace(str(checkout), "CHECKOUT")
            stored[f"{stream} {number}"] = {"line": re.sub(r"\b(?=\w*\d)[0-9a-f]{12,40}\b", "HASH", clean).splitlines()}
        stored[f"exit {number}"] = {"code": [str(done.returncode)]}
        if done.returncode:
            break
    for path in sorted(place.rglob("*")):
        inside = str(path.relative_to(place))
        if path.is_file() and not (INPUTS / inside).exists() and not IGNORED_FILES.search(inside):
            stored[inside] = columns_of(path)
    (folder / f"{name}.json").write_text(json.dumps(stored, indent=1))
    return f"{name}: {time.time() - start:.0f} s" + (f", FAILED: {done.stderr[-300:]}" if done.returncode else "")


def package_of(checkout: Path) -> str:
    """Import package of the commands; ``agents`` was its name before 0.1.0."""
    return "agents" if (checkout / "agents" / "__init__.py").exists() else "probe_agents"


def columns_of(path: Path) -> dict[str, list[str]]:
    """A stored file as columns of strings, floats with all their digits."""
    import numpy as np
    import pandas as pd

    if path.suffix in (".csv", ".parquet"):
        table = pd.read_csv(path, dtype=str, keep_default_na=False, comment="#") if path.suffix == ".csv" else (
            pd.read_parquet(path)
        )  # fmt: skip
        return {str(name): [str_of(cell) for cell in table[name]] for name in table if not IGNORED_NAMES.search(name)}
    if path.suffix in (".json", ".toml"):
        text = path.read_text()
        return flat(tomllib.loads(text) if path.suffix == ".toml" else json.loads(text))
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            kept = {name: arrays[name] for name in arrays.files if not IGNORED_NAMES.search(name)}
            return {f"{name} {array.shape}": list(map(str_of, array.ravel())) for name, array in kept.items()}
    if path.suffix in (".png", ".gif"):
        from matplotlib.image import imread

        return {"pixels": [hashlib.sha256(np.ascontiguousarray(imread(path)).tobytes()).hexdigest()]}
    text = path.read_text(errors="replace")
    if path.suffix == ".html":
        text = re.sub(r"<(style|script|svg).*?</\1>|<[^>]*>", "\n", text, flags=re.DOTALL)
    return {"line": [line.strip() for line in text.splitlines() if line.strip()]}


def str_of(value: Any) -> str:
    """All digits of a float of any precision; other values as they are printed."""
    return repr(float(value)) if hasattr(value, "dtype") and value.dtype.kind == "f" else str(value)


def flat(value: Any, name: str = "") -> dict[str, list[str]]:
    """Nested mappings and lists as one column a leaf; a list of scalars is one column."""
    if isinstance(value, dict):
        parts = [flat(item, f"{name}.{key}" if name else str(key)) for key, item in value.items()]
    elif isinstance(value, (list, tuple)) and any(isinstance(item, (dict, list)) for item in value):
        parts = [flat(item, f"{name}.{number}") for number, item in enumerate(value)]
    else:
        cells = list(value) if isinstance(value, (list, tuple)) else [value]
        return {} if IGNORED_NAMES.search(name) else {name: [str(cell) for cell in cells]}
    return {key: cells for part in parts for key, cells in part.items()}


def steps(env_id: str, number: int, settings: dict[str, Any]) -> None:
    """Step an environment with seeded random actions, single and in batches; all it returns goes to out/KIND.json."""
    import gymnasium as gym
    import numpy as np

    import probe_env  # noqa: F401 registers the environments

    for kind, count in KINDS.items():
        if env_id.startswith("Design") and kind != "single":
            continue
        rng, rows = np.random.default_rng(7), []
        if kind == "ProbeVecEnv":
            env: Any = vec_env()(f"probe_env/{env_id}", count, max_episode_steps=max(number // 3, 2), **settings)
            env.seed(11)
            rows.append({"observation": env.reset()})
        else:
            make = gym.make if kind == "single" else gym.make_vec
            env = make(f"probe_env/{env_id}", **({"num_envs": count} if count > 1 else {}), **settings)
            observation, info = env.reset(seed=11)
            rows.append({"observation": observation, "info": info})
        shape = env.action_space.shape if kind != "ProbeVecEnv" else (count, *env.action_space.shape)
        for _ in range(number):
            action = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
            names = ("observation", "reward", "terminated", "truncated", "info")
            names = names if kind != "ProbeVecEnv" else ("observation", "reward", "done", "info")
            rows.append(dict(zip(names, env.step(action), strict=True)))
            if kind == "single" and (rows[-1]["terminated"] or rows[-1]["truncated"]):
                rows.append(dict(zip(("observation", "info"), env.reset(), strict=True)))
        table: dict[str, list[str]] = {}
        for index, row in enumerate(rows):
            for name, cells in flat(plain(row)).items():
                table.setdefault(name, []).extend(f"step {index}: {cell}" for cell in cells)
        Path(f"out/{kind}.json").write_text(json.dumps(table))


def settings_of(words: list[str]) -> dict[str, Any]:
    """Settings of an environment from words such as fidelity=fast and, of the task, config.time_limit=60."""
    pairs = [word.split("=") for word in words]
    config = {name.removeprefix("config."): float(value) for name, value in pairs if name.startswith("config.")}
    settings = {name: value for name, value in pairs if not name.startswith("config.")}
    return settings | ({"config": config} if config else {})


def vec_env() -> Any:
    """`ProbeVecEnv` of the checkout."""
    with contextlib.suppress(ImportError):
        return __import__("probe_agents.vec_env", fromlist=["ProbeVecEnv"]).ProbeVecEnv
    return __import__("agents.vec_env", fromlist=["ProbeVecEnv"]).ProbeVecEnv


def plain(value: Any) -> Any:
    """Arrays as lists, floats as text with all their digits, other objects by their type."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)) or (hasattr(value, "ndim") and value.ndim):
        return [plain(item) for item in value]
    return str_of(value) if isinstance(value, (str, int, float, bool)) or hasattr(value, "dtype") else str(type(value))


def diff(first: Path, second: Path, names: list[str]) -> int:
    """Print the differences of two recordings case by case; return how many there are."""
    count, texts, alone = 0, 0, []
    for name in names:
        files = [folder / f"{name}.json" for folder in (first, second)]
        if not any(file.exists() for file in files):
            continue
        if not all(file.exists() for file in files):
            alone.append(f"{name}: not recorded in {second if files[0].exists() else first}")
            continue
        records: list[Record] = [json.loads(file.read_text()) for file in files]
        refused = [refusal(stored) for stored in records]
        if refused[0] != refused[1] and any(text and UNKNOWN.search(text) for text in refused):
            alone.append(
                f"{name}: only in {first if refused[1] else second}; the other says: {refused[0] or refused[1]}"
            )
            continue
        lines, added = differences(*records)
        count += len(lines)
        texts += sum(bool(TEXTS.match(line)) for line in lines)
        print(
            f"{name}: {f'{len(lines)} differences' if lines else 'equal'}"
            + (f", {len(added)} added or removed" * bool(added))
        )
        print("".join(f"    {line}\n" for line in [*lines, *added]), end="")
    print("".join(f"{line}\n" for line in alone), end="")
    print(
        f"{count} differences, {texts} of them in printed text, reports and pictures; "
        f"{len(alone)} cases in one recording only"
    )
    return count


def refusal(stored: Record) -> str:
    """The last line of a case that failed, else nothing."""
    last = max(int(name.split()[1]) for name in stored if name.startswith("exit "))
    return "" if stored[f"exit {last}"]["code"] == ["0"] else (stored[f"stderr {last}"]["line"] or ["no message"])[-1]


def differences(first: Record, second: Record) -> tuple[list[str], list[str]]:
    """Lines about values that differ, and about files and columns that only one of the records has."""
    lines, added = (
        [],
        [f"{name}: only in the {'first' if name in first else 'second'}" for name in first.keys() ^ second.keys()],
    )
    for file in first.keys() & second.keys():
        one, other = first[file], second[file]
        sides = {"first": sorted(one.keys() - other.keys()), "second": sorted(other.keys() - one.keys())}
        added += [
            f"{file}: {len(names)} columns only in the {side}: {', '.join(names)[:300]}"
            for side, names in sides.items()
            if names
        ]
        for column in one:
            if column in other and one[column] != other[column]:
                lines.append(f"{file}, {column}: {how(one[column], other[column])}")
    return sorted(lines), sorted(added)


def how(one: list[str], other: list[str]) -> str:
    """How two columns differ: numbers of rows, the first rows that differ, the largest relative difference."""
    rows = [row for row, pair in enumerate(zip(one, other, strict=False)) if pair[0] != pair[1]]
    text = "" if len(one) == len(other) else f"{len(one)} and {len(other)} rows; "
    text += f"{len(rows)} rows differ; " + "; ".join(
        f"{row}: {one[row][:120]!r} {other[row][:120]!r}" for row in rows[:SHOWN]
    )
    errors = [error for row in rows if (error := relative(one[row], other[row])) is not None]
    return text + (f"; largest relative difference {max(errors):.2g}" if errors else "")


def relative(one: str, other: str) -> float | None:
    """Relative difference of two numbers; None where one is text."""
    with contextlib.suppress(ValueError):
        a, b = (float(text.rpartition(": ")[2]) for text in (one, other))
        return abs(a - b) / max(abs(a), abs(b), 1e-300)
    return None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["record", "diff", "checkouts", "steps"])
    parser.add_argument("first")
    parser.add_argument("second")
    parser.add_argument("cases", nargs="*")
    arguments = parser.parse_args()
    if arguments.action == "steps":
        steps(arguments.first, int(arguments.second), settings_of(arguments.cases))
        return 0
    names = [name for name in CASES if any(fnmatch.fnmatch(name, pattern) for pattern in arguments.cases or ["*"])]
    first, second = Path(arguments.first), Path(arguments.second)
    if arguments.action == "record":
        record(first, second, names)
        return 0
    if arguments.action == "checkouts":
        folder = Path(tempfile.mkdtemp(prefix="golden-"))
        record(first, folder / "first", names)
        record(second, folder / "second", names)
        first, second = folder / "first", folder / "second"
    return int(diff(first, second, names) > 0)


if __name__ == "__main__":
    sys.exit(main())
