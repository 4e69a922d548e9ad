"""Who is let in by the server, and what it serves: requests to a server of this process."""

import asyncio
import gc
import os
import signal
import socket
import threading
import time
import weakref
from itertools import product
from types import SimpleNamespace

import pytest
from bokeh.models import Div
from tornado.gen import multi
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from probe_agents.app.screens.page import Page
from probe_agents.app.server import make_server
from probe_agents.cli import main

TOKEN = "secret"
SCRIPT = "/static/js/bokeh.min.js"
PATHS = ("/", "/report/?folder=.", "/autoload.js?bokeh-autoload-element=1", "/metadata", SCRIPT, "/ws")


@pytest.fixture
def made(app):
    """A function that makes a server, which other origins may name."""
    servers = []

    def make(*origins):
        asyncio.set_event_loop(asyncio.new_event_loop())  # Python 3.12 and later warn where none was made
        servers.append(make_server(app, None, 0, TOKEN, *origins))
        return servers[-1]

    yield make
    for server in servers:
        server.stop()
        server.io_loop.close()


@pytest.fixture
def server(made):
    return made()


@pytest.fixture
def get(server):
    """A function that returns the answer to a request, by default of a browser that has been let in.

    For a list of paths: the answers to requests at the same time.
    """
    server.start()
    client = AsyncHTTPClient(force_instance=True)

    def get(path, cookie=f"probe-env-{server.port}={TOKEN}", **headers):
        headers = {"Cookie": cookie, "Host": f"localhost:{server.port}"} | headers
        options = {"raise_error": False, "follow_redirects": False, "headers": headers}
        options |= {"connect_timeout": 60.0, "request_timeout": 60.0}

        def fetch(path):
            return client.fetch(f"http://127.0.0.1:{server.port}{path}", **options)

        return server.io_loop.run_sync(lambda: fetch(path) if isinstance(path, str) else multi(list(map(fetch, path))))

    yield get
    client.close()


def test_the_server_listens_to_this_machine_alone(server):
    origins = server._tornado.websocket_origins
    assert origins == {f"localhost:{server.port}", f"127.0.0.1:{server.port}"}
    assert [sock.getsockname()[0] for sock in server._http._sockets.values()] == ["127.0.0.1"]


@pytest.fixture
def blank(monkeypatch):
    """Pages of one element, which take no time."""
    page = SimpleNamespace(add_to=lambda document: document.add_root(Div()))
    monkeypatch.setattr("probe_agents.app.server.Page", lambda *_: page)


def test_one_garbage_collection_frees_all_closed_pages(server, blank, monkeypatch):
    application, collections, unfreeze = server._tornado.applications["/"].application, [], gc.unfreeze
    monkeypatch.setattr("probe_agents.app.server.gc.unfreeze", lambda: collections.append(unfreeze()))
    documents = [application.create_document() for _ in range(2)]
    assert gc.get_freeze_count() > 0
    pages, closed = [weakref.ref(d) for d in documents], [c for d in documents for c in d.session_destroyed_callbacks]
    del documents
    gc.collect()
    assert None not in [page() for page in pages]  # held by cycles of references
    for close in closed:
        close(None)
    deadline = time.monotonic() + 60.0
    while any(page() for page in pages) and time.monotonic() < deadline:
        server.io_loop.run_sync(lambda: asyncio.sleep(0.1))
    assert ([page() for page in pages], len(collections)) == ([None, None], 1)
    unfreeze()


def test_requests_without_the_token_are_refused(server, get):
    """By other users of the machine; a cookie of an app at another port is not for this one."""
    for path in (*PATHS, f"/?token={TOKEN}", "/login", "/login?token=", "/login?token=wrong", "/login?token=%FF"):
        for cookie in ("", f"probe-env-{server.port}=wrong", f"probe-env-{server.port + 1}={TOKEN}"):
            assert get(path, cookie).code == 403
    assert server.get_sessions("/") == []


def test_printed_address_sets_the_cookie_of_the_page(server, get):
    answer = get(f"/login?token={TOKEN}", cookie="")
    cookie, *attributes = answer.headers["Set-Cookie"].split("; ")
    assert (answer.code, answer.headers["Location"]) == (302, "/")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(attributes)
    assert get("/", cookie).code == 200
    own = f"http://localhost:{server.port}"
    for headers, code in (
        ({"Cookie": cookie, "Origin": own}, 101),
        ({"Cookie": "", "Origin": own}, 403),
        ({"Cookie": cookie, "Origin": "null"}, 403),  # a sandboxed report
        ({"Cookie": cookie, "Origin": "http://localhost:1"}, 403),
    ):
        assert connect(server, headers | {"Host": f"localhost:{server.port}"}) == code


def test_named_origin_is_accepted(made):
    """The other end of an SSH tunnel, or a proxy."""
    server = made("named.example:8080")
    server.start()
    for host, code in (("named.example:8080", 101), ("other.example:8080", 403)):
        headers = {"Host": host, "Origin": f"http://{host}", "Cookie": f"probe-env-{server.port}={TOKEN}"}
        assert connect(server, headers) == code


def test_a_port_that_is_taken_is_named(app, tmp_path, refused):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        refused(["app", "--port", port, "--no-show"], f"port {port} is taken: --port for another, --port 0 for any")


def connect(server, headers):
    """Status of the handshake of a websocket."""
    request = HTTPRequest(f"ws://127.0.0.1:{server.port}/ws", headers=headers)
    try:
        server.io_loop.run_sync(lambda: websocket_connect(request)).close()
    except HTTPClientError as error:
        return error.code
    return 101


def test_other_sites_are_refused_even_with_the_cookie(server, get):
    """Another port of this machine is one of the same site; a foreign host is that of DNS rebinding."""
    for header, values in (
        ("Origin", ("http://evil.example", "null", "http://localhost:1")),
        ("Sec-Fetch-Site", ("cross-site", "same-site")),
        ("Host", ("evil.example",)),
    ):
        for value, path in product(values, (*PATHS, f"/login?token={TOKEN}")):
            assert get(path, **{header: value}).code == 403, (header, value)
    assert server.get_sessions("/") == []


def test_only_shown_reports_are_served_in_a_sandbox(app, get, tmp_path):
    for name in ("opened", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "setting.json").write_text("{}")
        (tmp_path / name / "report.html").write_text("<script>open('/')</script>")
    Page(app).compare.open.value = str(tmp_path / "opened")
    answer = get(f"/report/?folder={tmp_path}/opened")
    assert (answer.code, answer.body) == (200, b"<script>open('/')</script>")
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    policy = answer.headers["Content-Security-Policy"].split("; ")
    assert policy[:2] == ["sandbox allow-scripts allow-downloads allow-popups", "default-src 'none'"]
    for folder in ("other", "opened/../other", "."):
        assert get(f"/report/?folder={tmp_path}/{folder}").code == 404


def test_the_number_of_pages_is_bounded(server, blank, get, monkeypatch):
    """Also of those requested at once."""
    monkeypatch.setattr("probe_agents.app.server.MAX_PAGES", 2)
    assert sorted(answer.code for answer in get(["/"] * 4)) == [200, 200, 503, 503]
    assert [get(path).code for path in ("/", PATHS[2], SCRIPT)] == [503, 503, 200]
    assert len(server.get_sessions("/")) == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_idle_server_which_prints_nothing(number, tmp_path, monkeypatch, capsys):
    """Its stdout may have no reader left; the exit status is that of success."""
    closed = []
    queue = SimpleNamespace(runs=(), changes=0, close=lambda: closed.append(True))
    monkeypatch.setattr("probe_agents.app.server.RunQueue", lambda: queue)
    monkeypatch.setattr("webbrowser.open", lambda _: threading.Timer(0.3, os.kill, (os.getpid(), number)).start())
    asyncio.set_event_loop(loop := asyncio.new_event_loop())
    assert main(["app", "--port", "0", "--output", str(tmp_path)]) == 0
    loop.close()
    printed = capsys.readouterr()
    assert (printed.out.count("\n"), printed.err, closed) == (1, "", [True])


def test_a_closed_page_takes_no_time(server, get, monkeypatch):
    ticks = []
    monkeypatch.setattr(Page, "tick", lambda page: ticks.append(page))

    def wait():
        ticks.clear()
        server.io_loop.run_sync(lambda: asyncio.sleep(0.5))
        return len(ticks)

    assert [get("/").code for _ in range(3)] == [200] * 3
    assert wait() > 0
    server.io_loop.run_sync(lambda: server._tornado.applications["/"]._cleanup_sessions(0))
    assert (server.get_sessions("/"), wait()) == ([], 0)
