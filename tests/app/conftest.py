"""An app without a worker."""

from types import SimpleNamespace

import pytest

from probe_agents.app.state import AppState


@pytest.fixture
def app(tmp_path):
    return AppState(SimpleNamespace(runs=(), changes=0), tmp_path)
