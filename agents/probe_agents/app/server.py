"""HTTP server on localhost; serves local files and makes no outgoing requests."""

import errno
import gc
import re
import secrets
import socket
import webbrowser
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from bokeh.application.application import Application, ServerContext
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Matcher, Rule
from tornado.web import HTTPError, RequestHandler

from probe_agents.app.runs import RunQueue
from probe_agents.app.screens.page import Page
from probe_agents.app.screens.widgets import REPORT_URL
from probe_agents.app.state import AppState
from probe_agents.records.shipped import file_or_shipped
from probe_env import Plant
from probe_env.files import escaped

HOSTS: Final = ("localhost", "127.0.0.1")
LOGIN_URL: Final = "/login"
MAX_PAGES: Final = 32
"""Most open pages; a closed one counts for half a minute."""
REPORT_POLICY: Final = (
    "sandbox allow-scripts allow-downloads allow-popups; default-src 'none'; img-src data:;"
    " style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-ancestors 'self'"
)
"""A report can be somebody else's: its scripts run without the origin of the app, and load nothing."""


class Gate(Matcher):
    """Matches the requests to refuse, with status and reason.

    These are requests to another host name (DNS rebinding), by another site, and without the token, which is in the
    printed address and then in a cookie.
    """

    def __init__(self, hosts: Collection[str], cookie: str, token: str) -> None:
        self.hosts, self.cookie, self.token = hosts, cookie, token

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        """Arguments of ``Refusal``; None: the request is not refused."""
        refusal = self._refusal(request)
        return refusal and {"target_kwargs": dict(zip(("status", "reason"), refusal, strict=True))}

    def _refusal(self, request: HTTPServerRequest) -> tuple[int, str] | None:
        headers = request.headers
        if "Origin" in headers:
            same_site = headers["Origin"] == f"http://{request.host}"
        else:
            same_site = headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin")
        if request.host_name not in self.hosts or not same_site:
            return 403, "Request by another site: paste the printed address into the browser"
        cookie = request.cookies.get(self.cookie)
        token = cookie.value.encode() if cookie else b""
        if request.path == LOGIN_URL:
            token = request.query_arguments.get("token", [b""])[0]
        if not secrets.compare_digest(token, self.token.encode()):
            return 403, "Open the address that probe-env app has printed"
        return None


class Refusal(RequestHandler):
    """Answer to a refused request."""

    def initialize(self, status: int, reason: str) -> None:
        """Set the answer."""
        self.status, self.reason = status, reason

    def prepare(self) -> None:
        """Refuse, whatever the method."""
        raise HTTPError(self.status, reason=self.reason)


class PageHandler(FunctionHandler):  # type: ignore[misc]  # bokeh is not followed
    """Makes at most ``MAX_PAGES`` pages."""

    context: ServerContext

    def on_server_loaded(self, server_context: ServerContext) -> None:
        """Keep the list of open pages."""
        self.context = server_context

    def process_request(self, request: HTTPServerRequest) -> dict[str, Any]:
        """Refuse a page too many, just before it is made: others can be requested at the same time."""
        if len(self.context.sessions) >= MAX_PAGES:
            raise HTTPError(503, reason="Too many pages are open: close some and wait half a minute")
        return {}


class LoginHandler(RequestHandler):
    """Sets the cookie of a browser that has opened the printed address."""

    def initialize(self, cookie: str, token: str) -> None:
        """Set name and value of the cookie."""
        self.cookie, self.token = cookie, token

    def get(self) -> None:
        """Set the cookie and redirect to the page."""
        self.set_cookie(self.cookie, self.token, httponly=True, samesite="Strict")
        self.redirect("/")


class ReportHandler(RequestHandler):
    """Serves ``report.html`` of evaluation folders that a page has shown."""

    def initialize(self, folders: Collection[Path]) -> None:
        """Set the folders."""
        self.folders = folders

    def get(self) -> None:
        """Send the report of the folder in the query."""
        folder = Path(self.get_query_argument("folder"))
        if folder not in self.folders or not (folder / "report.html").is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.write((folder / "report.html").read_bytes())


def serve(tube: Path | None, port: int, output: Path, show: bool, origin: str | None = None) -> None:
    """Serve the page until interrupted by a signal.

    Args:
        tube: initial tube file, or name of a shipped one; None: the study's tubes.
        port: port; 0: any free one.
        output: folder of runs, schedules and tubes.
        show: open a browser.
        origin: another address of the page, "host:port", which is printed.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"port = {port!r} is outside the accepted range 0 (any) to 65535")
    if origin is not None and not re.fullmatch(r"[a-z0-9.-]+:\d{1,5}", origin):
        raise ValueError(f"origin = {origin!r} is not host:port, such as localhost:8080")
    path = None if tube is None else file_or_shipped("tubes", tube)
    if path is not None:
        Plant.from_toml(path)
    app = AppState(RunQueue(), output)
    try:
        token = secrets.token_urlsafe()
        server = make_server(app, path, port, token, origin)
        server.start()
        address = f"http://{origin or f'localhost:{server.port}'}{LOGIN_URL}?token={token}"
        with suppress(KeyboardInterrupt):  # raised by a signal, see probe_agents.cli.interrupts
            page = f"the page is at {address} (Ctrl-C ends it)"
            print(escaped(f"{page}; results are stored in {output}/"), flush=True)
            if show:
                webbrowser.open(address)
            # not run_until_shutdown: its handler of SIGTERM prints, which fails where the reader of stdout is gone
            server.io_loop.start()
        server.stop()
    finally:
        app.queue.close()


def make_server(app: AppState, tube: Path | None, port: int, token: str, origin: str | None = None) -> BaseServer:
    """Make a server, not started, for requests with the token; pages load all files from it."""
    waiting: list[object] = []  # for garbage collection, which takes as long for one page as for all that were closed

    def collect_soon(session: Any) -> None:
        if not waiting:
            waiting.append(IOLoop.current().call_later(1.0, collect_garbage))

    def collect_garbage() -> None:
        waiting.clear()
        gc.unfreeze()
        gc.collect()
        gc.freeze()

    def open_document(document: Document) -> None:
        Page(app, tube).add_to(document)
        document.on_session_destroyed(collect_soon)
        gc.freeze()  # a garbage collection of open pages would stop them for 0.3 s

    try:
        listener = socket.create_server((HOSTS[1], port))
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise
        raise OSError(f"port {port} is taken: --port for another, --port 0 for any") from error
    listener.setblocking(False)
    port = listener.getsockname()[1]
    origins = [f"{host}:{port}" for host in HOSTS] + ([origin] if origin else [])
    hosts = {each.partition(":")[0] for each in origins}
    secret = {"cookie": f"probe-env-{port}", "token": token}  # a browser sends cookies to all ports of a host
    pages = BokehTornado(
        {"/": Application(PageHandler(open_document))},
        absolute_url=f"http://{HOSTS[0]}:{port}/",
        extra_websocket_origins=origins,
        extra_patterns=[(REPORT_URL, ReportHandler, {"folders": app.reports}), (LOGIN_URL, LoginHandler, secret)],
        check_unused_sessions_milliseconds=10_000,
    )
    http = HTTPServer(pages)
    http.add_socket(listener)
    server = BaseServer(IOLoop.current(), pages, http)
    # not an auth_provider: Bokeh asks it neither for static files nor for other patterns
    pages.add_handlers(".*", [Rule(Gate(hosts, **secret), Refusal)])
    return server
