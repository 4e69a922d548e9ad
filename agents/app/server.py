"""HTTP server on localhost; serves local files and makes no outgoing requests."""

from __future__ import annotations

import gc
import socket
import webbrowser
from pathlib import Path
from typing import Any, Final

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.auth_provider import NullAuth
from bokeh.server.server import Server
from tornado.web import HTTPError, RequestHandler

from agents.app.runs import RunQueue
from agents.app.screens.page import Page
from agents.app.screens.widgets import REPORT_URL
from agents.app.state import AppState
from agents.records.shipped import file_or_shipped
from probe_env import Plant

HOSTS: Final = ("localhost", "127.0.0.1")


def check_host(handler: RequestHandler) -> str:
    """Refuse requests addressed to another host name, which another site may have pointed here; returns the user."""
    if handler.request.host_name not in HOSTS:
        raise HTTPError(403)
    return "local"


class LocalAuth(NullAuth):  # type: ignore[misc]  # bokeh is not typed
    """Authentication of pages and their connections: requests to this machine only."""

    get_user = property(lambda self: check_host)
    login_url = property(lambda self: "/")  # unused, but required by Bokeh


class ReportHandler(RequestHandler):
    """Serves ``report.html`` of evaluation folders and nothing else."""

    def get(self) -> None:
        """Send the report of the folder in the query."""
        check_host(self)
        folder = Path(self.get_query_argument("folder"))
        if not (folder / "report.html").is_file() or not (folder / "setting.json").is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.write((folder / "report.html").read_bytes())


def serve(tube: Path | None, port: int, output: Path, show: bool) -> None:
    """Serve the page until interrupted.

    Args:
        tube: tube file, or name of a shipped one, with which pages begin; None: the study's tubes.
        port: port; 0: any free one.
        output: folder of runs, schedules and tubes.
        show: open a browser.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"port = {port!r} is outside the accepted range 0 (any) to 65535")
    path = None if tube is None else file_or_shipped("tubes", tube)
    if path is not None:
        Plant.from_toml(path)
    app = AppState(RunQueue(), output)
    try:
        server = make_server(app, path, port)
        server.start()
        address = f"http://localhost:{server.port}/"
        print(f"the page is at {address} (Ctrl-C ends it); results are stored in {output}/", flush=True)
        if show:
            webbrowser.open(address)
        server.run_until_shutdown()
    finally:
        app.queue.close()


def make_server(app: AppState, tube: Path | None, port: int) -> Server:
    """A server that has not started; pages load everything from it."""

    def collect_garbage(session: Any) -> None:  # of closed pages
        gc.unfreeze()
        gc.collect()
        gc.freeze()

    def open_document(document: Document) -> None:
        Page(app, tube).add_to(document)
        document.on_session_destroyed(collect_garbage)
        gc.freeze()  # a garbage collection of open pages would stop them for 0.3 s

    if port == 0:  # the accepted origins must name it before the server starts
        with socket.create_server((HOSTS[1], 0)) as probe:
            port = int(probe.getsockname()[1])
    return Server(
        {"/": Application(FunctionHandler(open_document))},
        address=HOSTS[1],
        port=port,
        allow_websocket_origin=[f"{host}:{port}" for host in HOSTS],
        extra_patterns=[(REPORT_URL, ReportHandler)],
        auth_provider=LocalAuth(),
        check_unused_sessions_milliseconds=10_000,
    )
