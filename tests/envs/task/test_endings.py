"""Another ending is a field, its rule and its words: everything else has it then."""

import subprocess
import sys
from pathlib import Path

from agents.records.columns import CORE_FAILURES, sentence_of
from probe_env.envs.task import ENDINGS, FAILURES, Ending

ROOT = Path(__file__).parents[3]


def test_every_failure_has_its_words_and_is_stored():
    assert Ending._fields == (*ENDINGS, "out_of_time")
    assert ENDINGS[1:] == FAILURES
    assert [sentence_of(name) for name in ("lost_drive", "diverged")] == ["lost their drive", "diverged"]
    assert set(CORE_FAILURES) <= set(FAILURES)


def test_another_ending_is_in_all_that_is_told():
    """In a process of its own, where the rules are edited before anything is derived from them."""
    command = [sys.executable, str(Path(__file__).with_name("another_ending.py"))]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    for line in (
        "complete, 0 lost drive, 0 diverged, 1 jammed\n",
        "bent: 0 lost drive, 0 diverged, 1 jammed\n",
        "1 jammed, 0 diverged, 0 lost their drive\n",
        "insertions lost their drive or diverged or jammed.",
    ):
        assert line in run.stdout
