"""A small evaluation that is played once, and copies of its folder."""

import shutil
from pathlib import Path

import pytest
from plans import make_plan

from probe_agents.evaluation.run import evaluate_plan


@pytest.fixture(scope="session")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished evaluation of ``make_plan()``; not to be changed."""
    folder = tmp_path_factory.mktemp("evaluated") / "evaluation"
    evaluate_plan(make_plan(), folder)
    return folder


@pytest.fixture
def stored(evaluated: Path, tmp_path: Path) -> Path:
    """A copy of ``evaluated``."""
    return Path(shutil.copytree(evaluated, tmp_path / "evaluation"))
