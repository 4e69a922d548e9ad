"""The app's server in its own process, and Chromium: `make test-app`.

With PROBE_ENV_THROTTLE=6 the browser is six times slower, as on a busy machine.
"""

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

CHROMIUM = os.environ.get("PROBE_ENV_CHROMIUM", "/usr/bin/chromium")
LONG = 120_000
"""Time limit for something that takes seconds [ms]."""


class App:
    """A running app: its printed address, the address without its token, the folder of its runs, and its own one."""

    def __init__(self, output: Path, tube: Path | None, folder: Path | None) -> None:
        self.output, self.tube, self.folder = output, tube, folder
        self.start()

    def start(self) -> None:
        options = ["--port", "0", "--no-show", "--output", str(self.output)]
        options += [] if self.tube is None else ["--tube", str(self.tube)]
        command = [sys.executable, "-m", "probe_agents.cli", "app", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=self.folder)
        line = self.process.stdout.readline()
        self.printed = re.search(r"http://localhost:\d+/\S+", line)[0]
        self.address = self.printed.partition("login")[0]

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()


@contextmanager
def served(output: Path, tube: Path | None = None, folder: Path | None = None):
    app = App(output, tube, folder)
    try:
        yield app
    finally:
        app.kill()


@pytest.fixture(scope="session")
def browser():
    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def tube(tmp_path_factory):
    """A tube of 7 m, in which an insertion is short."""
    path = tmp_path_factory.mktemp("tube") / "short.toml"
    path.write_text("[tube]\nhelix_length = 7.0\n[contact]\nfriction = { low = 0.1, high = 0.2 }\n")
    return path


@pytest.fixture(scope="session")
def app(tmp_path_factory, tube):
    """An app with a short tube, shared by tests that do not change its state."""
    with served(tmp_path_factory.mktemp("app"), tube) as running:
        yield running


@pytest.fixture
def page(browser, app):
    """A page of that app; requests to other hosts and errors in the browser are failures."""
    with opened(browser, app) as page:
        yield page


@contextmanager
def opened(browser, app, width=1280):
    context = browser.new_context(viewport={"width": width, "height": 900}, locale="en-GB")
    page = context.new_page()
    page.set_default_timeout(LONG)
    urls, errors = [], []
    page.on("request", lambda request: urls.append(request.url))
    page.on("websocket", lambda socket: urls.append(socket.url.replace("ws:", "http:", 1)))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    if throttle := os.environ.get("PROBE_ENV_THROTTLE"):
        context.new_cdp_session(page).send("Emulation.setCPUThrottlingRate", {"rate": float(throttle)})
    page.goto(app.printed)
    page.get_by_text("Expected:").wait_for()
    page.wait_for_function("window.probe_env_is_ready")
    yield page
    assert [url for url in urls if not url.startswith((app.address, "data:", "blob:"))] == []
    assert errors == []
    context.close()
