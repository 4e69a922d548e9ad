"""The tests marked ``processor`` as other processors round: ``python tests/processors.py`` (``make test-processors``).

OpenBLAS and numba choose code by processor, so the last digits differ, and in chaos all that follows from them. Each
kind is asked for through their environment variables, as far as this machine's own instructions allow. numba keeps this
machine's features under the name of another processor unless they are left to the name. Shifted seeds are other draws
of every statistical test.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from pathlib import Path

KINDS = {
    "haswell": {"OPENBLAS_CORETYPE": "Haswell", "NUMBA_CPU_NAME": "haswell"},
    "zen 3": {"OPENBLAS_CORETYPE": "Zen", "NUMBA_CPU_NAME": "znver3"},
    "skylake-x": {"OPENBLAS_CORETYPE": "SkylakeX", "NUMBA_CPU_NAME": "skylake-avx512"},
    "generic": {"NUMBA_CPU_NAME": "generic"},  # of the oldest x86-64: no fused multiply-add
}
NEEDS = {"haswell": "avx2", "zen 3": "avx2", "skylake-x": "avx512f"}
"""Feature of this machine without which a kind cannot run here."""
SHIFTS = (1, 2, 3)
CHOSEN = "from probe_agents.records.manifest import origin; print(origin()['machine']['kernels'])"
"""Says what linear algebra and numba chose: OpenBLAS has no routines for every name, and takes Haswell's for Zen."""
ROOT = Path(__file__).parents[1]


def configurations() -> dict[str, tuple[dict[str, str], int]]:
    """Name -> environment and shift of the seeds, of everything that can run here."""
    here = set(Path("/proc/cpuinfo").read_text().split()) if Path("/proc/cpuinfo").exists() else set()
    possible = {name: kind for name, kind in KINDS.items() if NEEDS.get(name, "") in here | {""}}
    for name in KINDS.keys() - possible.keys():
        print(f"{name}: left out, this machine has no {NEEDS[name]}")
    plain = {name: (kind | {"NUMBA_CPU_FEATURES": ""}, 0) for name, kind in possible.items()}
    return plain | {f"this one, seeds shifted by {shift}": ({}, shift) for shift in SHIFTS}


def run(name: str, variables: dict[str, str], shift: int, output: Path, options: list[str]) -> tuple[int, str, float]:
    """Exit status of pytest, its last line and what was chosen, and minutes; all that it said is in ``output``."""
    begin, slug, environment = time.monotonic(), re.sub(r"\W+", "-", name), os.environ | variables
    if variables:  # kernels of another processor must not lie beside those of this one
        environment["NUMBA_CACHE_DIR"] = str(output / slug)
        subprocess.run([sys.executable, "-m", "probe_env.compile_kernels"], cwd=ROOT, env=environment, check=True)
    chosen = subprocess.run([sys.executable, "-c", CHOSEN], cwd=ROOT, env=environment, capture_output=True, text=True)
    command = [sys.executable, "-m", "pytest", "-m", "processor", f"--shift-seeds={shift}", *options]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    (output / f"{slug}.txt").write_text(done.stdout + done.stderr)
    lines = done.stdout.strip().splitlines() or done.stderr.strip().splitlines() or ["no output"]
    said = f"{lines[-1].strip('= ')} ({chosen.stdout.strip()})"
    return done.returncode, said, (time.monotonic() - begin) / 60.0


def main() -> int:
    """Run all configurations, or those named; print a table; 1 if a test failed anywhere."""
    parser = argparse.ArgumentParser(description=__doc__, epilog="Other options go to pytest.")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="configurations, by a part of their name")
    parser.add_argument("--output", type=Path, default=ROOT / "output" / "processors", help="folder of caches and logs")
    arguments, options = parser.parse_known_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    every = configurations()
    chosen = [name for name in every if not arguments.only or any(part in name for part in arguments.only)]
    failed = 0
    print(f"{'configuration':32} {'verdict':8} {'min':>5}  pytest", flush=True)
    for name in chosen:
        status, line, minutes = run(name, *every[name], arguments.output.absolute(), options)
        failed += status != 0
        print(f"{name:32} {'failed' if status else 'passed':8} {minutes:5.1f}  {line}", flush=True)
    print(f"{len(chosen) - failed} of {len(chosen)} passed; logs in {arguments.output}")
    return 1 if failed or not chosen else 0


if __name__ == "__main__":
    raise SystemExit(main())
