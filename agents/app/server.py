"""The server of the page: bound to this machine, its own files only, no word to anybody else."""

from __future__ import annotations

import gc
import socket
import webbrowser
from pathlib import Path
from typing import Any, Final

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.auth_provider import AuthProvider
from bokeh.server.server import Server
from tornado.web import HTTPError, RequestHandler

from agents.app.desk import Office
from agents.app.page.document import page_of
from agents.app.page.runs import REPORT
from agents.app.runs.queue import Queue
from agents.records.shipped import file_or_shipped
from probe_env import Plant

HERE: Final = ("localhost", "127.0.0.1")
FILE: Final = "report.html"
MOST_PORT: Final = 65535


class _LocalOnly(AuthProvider):  # type: ignore[misc]  # bokeh is not typed
    """Refuses requests that were not addressed to this machine: another site's name may point here."""

    @property
    def get_user(self) -> Any:
        return _checked

    @property
    def get_user_async(self) -> None:
        return None

    @property
    def login_url(self) -> str:
        return "/"

    @property
    def get_login_url(self) -> None:
        return None

    @property
    def login_handler(self) -> None:
        return None

    @property
    def logout_url(self) -> None:
        return None

    @property
    def logout_handler(self) -> None:
        return None


class _Report(RequestHandler):
    """The report of a stored evaluation: a file of that name in the folder of one, and nothing else."""

    def get(self) -> None:
        """Send it; it can load nothing, by its own policy."""
        _checked(self)
        path = Path(self.get_query_argument("folder")) / FILE
        if not path.is_file() or not (path.parent / "setting.json").is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.write(path.read_bytes())


def _checked(handler: RequestHandler) -> str:
    if handler.request.host_name not in HERE:
        raise HTTPError(403)
    return "here"


def _collect(session: Any) -> None:
    """A page was closed: look once through everything, for what went with it or with those before."""
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def _free_port() -> int:
    """A port that nobody listens at: the origins that are let in must name it."""
    with socket.create_server((HERE[1], 0)) as probe:
        return int(probe.getsockname()[1])


def serve(tube: Path | None, port: int, output: Path, show: bool) -> None:
    """Serve the page until it is interrupted.

    Args:
        tube: a plant's file or the name of one that ships, that pages begin with; None: the study's tubes.
        port: to listen at; 0: any that is free.
        output: folder of runs, schedules and tubes.
        show: open a browser.

    Raises:
        FileNotFoundError: no such tube.
        ValueError: the tube's file is not valid, or a port that there is not.
        OSError: the port is in use.
    """
    if not 0 <= port <= MOST_PORT:
        raise ValueError(f"port = {port!r} is outside the accepted range 0 (any) to {MOST_PORT}")
    path = None if tube is None else file_or_shipped("tubes", tube)
    if path is not None:
        Plant.from_toml(path)
    office = Office(Queue(), output)
    try:
        server = server_of(office, path, port)
        server.start()
        address = f"http://localhost:{server.port}/"
        print(f"the page is at {address} (Ctrl-C ends it); what is finished is kept in {output}/", flush=True)
        if show:
            webbrowser.open(address)
        server.run_until_shutdown()
    finally:
        office.queue.close()


def server_of(office: Office, tube: Path | None, port: int) -> Server:
    """A server that is not started yet; it loads everything from itself."""

    def open_page(document: Document) -> None:
        page_of(office, tube).add_to(document)
        document.on_session_destroyed(_collect)
        gc.freeze()  # what is loaded and shown: to look through it for garbage stops the page for a third of a second

    taken = port or _free_port()
    origins = [f"{host}:{taken}" for host in HERE]
    return Server(
        {"/": Application(FunctionHandler(open_page))}, address=HERE[1], port=taken, allow_websocket_origin=origins,
        extra_patterns=[(REPORT, _Report)], auth_provider=_LocalOnly(), check_unused_sessions_milliseconds=10_000,
    )  # fmt: skip
