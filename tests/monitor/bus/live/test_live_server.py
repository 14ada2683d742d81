"""What the live page's server answers and refuses; clients that are slow, silent or too many."""

import argparse
import asyncio
import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any

import httpx
import pytest

from monitor.bus.live import page
from monitor.bus.live.address import PageAddress, is_loopback, listen, may_ask, parse
from monitor.bus.live.hub import RING, SAMPLES, STREAMS, WINDOWS, Hub
from monitor.bus.live.page import FILES, HEADERS, Page
from tests.helpers.bus.beside import beside, until

HOST = "127.0.0.1"


LARGE = json.dumps({"samples": [[0, 1.0, 1.0, 1]] * 3000, "windows": []}).encode() + b"\n"


class Running:
    def __init__(self, *, loopback: bool = True) -> None:
        self.hub = Hub()
        self.page = Page(self.hub, lambda header: may_ask(header, HOST, loopback=loopback))
        self._loop, self._ended = asyncio.new_event_loop(), asyncio.Event()
        listening = listen(PageAddress(HOST, 0))
        self.port = listening.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/"

        async def serve() -> None:
            limit = page.REQUEST_BYTES
            async with await asyncio.start_server(self.page.serve, sock=listening, limit=limit):
                await self._ended.wait()
                while self.page.connections:
                    await asyncio.sleep(0.01)

        self._thread = threading.Thread(target=lambda: self._loop.run_until_complete(serve()))
        self._thread.start()
        httpx.get(self.url)

    def get(self, path: str, method: str = "GET", **headers: str) -> httpx.Response:
        return httpx.request(method, f"http://{HOST}:{self.port}{path}", headers=headers)

    def take(self, *lines: bytes) -> None:
        self.call(lambda: [self.hub.take(line) for line in lines])

    def call(self, function: Any) -> Any:
        done: Future[Any] = Future()
        self._loop.call_soon_threadsafe(lambda: done.set_result(function()))
        return done.result(5.0)

    def close(self) -> None:
        self.call(lambda: self.hub.ended or self.hub.end())
        self.call(self._ended.set)
        self._thread.join(10.0)
        assert not self._thread.is_alive()
        self._loop.close()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:
    monkeypatch.setattr(page, "REQUEST_S", 0.5)
    monkeypatch.setattr(page, "STALLED_S", 0.5)
    with contextlib.closing(Running()) as running:
        yield running


def message(**more: Any) -> bytes:
    return json.dumps({"samples": [], "windows": [], **more}).encode() + b"\n"


@pytest.mark.parametrize("path", FILES)
def test_every_file_of_the_page_is_served_with_its_type(path: str, server: Running) -> None:
    answer = server.get(path)
    assert answer.status_code == 200
    assert len(answer.content) > 100
    kind = answer.headers["content-type"].split(";")[0]
    wanted = {"css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
    assert kind == wanted.get(path.rpartition(".")[2], "text/html")


@pytest.mark.parametrize("path", ["/", "/live.js", "/nothing", "/events"])
def test_every_answer_has_the_headers(path: str, server: Running) -> None:
    answer = server.get(path, "HEAD")
    for name, value in HEADERS.items():
        assert answer.headers[name] == value
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "BREW"])
def test_whatever_could_write_is_refused(method: str, server: Running) -> None:
    answer = server.get("/events", method)
    assert answer.status_code == 405
    assert answer.headers["allow"] == "GET, HEAD"
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_what_is_not_there_is_not_found(server: Running) -> None:
    for path in ("/nothing", "/static/live.js", "/../../etc/passwd", "/live.js/", "/%2e%2e/x"):
        assert server.get(path).status_code == 404, path


@pytest.mark.parametrize(
    ("header", "loopback", "wanted"),
    [
        ("127.0.0.1:8765", True, True),
        ("127.0.0.1", True, True),
        ("localhost:8765", True, True),
        ("LOCALHOST", True, True),
        ("[::1]:8765", True, True),
        ("evil.example:8765", True, False),
        ("localhost.evil.example", True, False),
        ("192.168.1.7:8765", True, False),
        ("192.168.1.7:8765", False, True),
        ("[fe80::1]:8765", False, True),
        ("evil.example:8765", False, False),
        ("", True, False),
        ("127.0.0.1:8765@evil.example", True, False),
        ("127.0.0.1, evil.example", False, False),
        ("[::1", True, False),
        ("localhost:", True, False),
    ],
)
def test_only_this_pages_own_names_are_answered(header: str, loopback: bool, wanted: bool) -> None:
    assert may_ask(header, "127.0.0.1", loopback=loopback) is wanted
    assert may_ask("Bench.lan:80", "bench.LAN", loopback=loopback)  # what was asked for
    with contextlib.closing(Running(loopback=loopback)) as own:
        assert own.get("/", host=header).status_code == (200 if wanted else 421)


@pytest.mark.parametrize("site", ["cross-site", "same-site", "?"])
def test_another_site_cannot_use_up_the_streams(site: str, server: Running) -> None:
    assert server.get("/events", **{"sec-fetch-site": site}).status_code == 403


def test_a_browser_that_comes_gets_the_past_at_once(server: Running) -> None:
    server.take(message(channel="vcan0", samples=[[0, 1.0, 1.01, 4095]], now={"ms": 0}))
    server.take(message(samples=[[100, 1.1, 1.02, 4095]], now={"ms": 100}))
    server.call(server.hub.end)  # so that the stream ends
    answer = server.get("/events")
    assert answer.headers["content-type"].startswith("text/event-stream")
    retry, snapshot, *_ = answer.text.split("\n\n")
    assert retry == "retry: 1000"
    state = json.loads(snapshot.removeprefix("event: snapshot\ndata: "))
    assert state["channel"] == "vcan0"
    assert [sample[0] for sample in state["samples"]] == [0, 100]
    assert state["now"] == {"ms": 100}


def test_streams_get_what_they_missed_and_the_whole_when_they_missed_too_much() -> None:
    hub = Hub()
    place, _ = asyncio.run(hub.after(None))
    for i in range(3):
        hub.take(message(now={"ms": i}))
    later, missed = asyncio.run(hub.after(place))
    assert missed.count(b"data: ") == 3

    async def fallen_behind() -> bytes:
        waiting = asyncio.ensure_future(hub.after(later))
        await asyncio.sleep(0)
        for i in range(RING + 1):
            hub.take(message(now={"ms": i}))
        return (await waiting)[1]

    whole = asyncio.run(fallen_behind())
    assert (whole[:15], whole.count(b"data: ")) == (b"event: snapshot", 1)


def test_what_the_server_keeps_is_bounded() -> None:
    hub = Hub()
    for _ in range(20):
        hub.take(message(samples=[[0, 1, 1, 0]] * 1000, windows=[{"index": 0}] * 50))
    state = json.loads(hub.snapshot().split(b"data: ")[1])
    assert (len(state["samples"]), len(state["windows"])) == (SAMPLES, WINDOWS)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("8765", PageAddress("127.0.0.1", 8765)),
        ("127.0.0.1:0", PageAddress("127.0.0.1", 0)),
        ("bench.lan:80", PageAddress("bench.lan", 80)),
        ("0.0.0.0:8765", PageAddress("0.0.0.0", 8765)),
        ("[::1]:8765", PageAddress("::1", 8765)),
    ],
)
def test_addresses_are_understood(text: str, wanted: PageAddress) -> None:
    assert parse(text) == wanted


@pytest.mark.parametrize("text", ["", "host", "host:", "host:70000", ":8765", "::1:8765", "a b:1"])
def test_other_texts_are_no_addresses(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="HOST:PORT is wanted"):
        parse(text)


def test_loopback_is_known_from_the_rest() -> None:
    for host, wanted in ((HOST, True), ("localhost", True), ("0.0.0.0", False)):
        with listen(PageAddress(host, 0)) as server:
            assert is_loopback(server) is wanted
    assert PageAddress("0.0.0.0", 80).url == "http://127.0.0.1:80/"
    assert PageAddress("::1", 80).url == "http://[::1]:80/"


def connect(port: int, text: bytes = b"") -> socket.socket:
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.settimeout(5.0)
    client.connect(("127.0.0.1", port))
    client.sendall(text)
    return client


@contextlib.contextmanager
def connected(port: int, n: int, text: bytes = b"") -> Iterator[list[socket.socket]]:
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(connect(port, text)) for _ in range(n)]


EVENTS = b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n"


def test_a_browser_that_never_reads_is_cut_off_and_others_are_served(server: Running) -> None:
    seen: list[str] = []

    def read() -> None:
        with httpx.stream("GET", server.url + "events", timeout=5.0) as answer:
            seen.extend(line[:30] for line in answer.iter_lines())

    with connect(server.port, EVENTS), beside(lambda _: read()):
        assert until(lambda: server.hub.streams == 2)
        # WHEN more is told than the kernel's buffers and the server's hold
        end_s = time.monotonic() + 10.0
        while server.hub.streams == 2 and time.monotonic() < end_s:
            server.take(LARGE)
            time.sleep(0.02)
        # THEN the one that reads is the one that is left
        assert server.hub.streams == 1
        server.take(b'{"samples":[],"windows":[],"channel":"last"}\n')
        server.call(server.hub.end)
    assert 'data: {"samples":[],"windows":' in seen
    assert "event: ended" in seen


def test_what_a_browser_that_never_reads_can_hold_is_bounded(server: Running) -> None:
    with connect(server.port, EVENTS):
        assert until(lambda: server.hub.streams == 1)
        flow = server.call(lambda: next(iter(server.page.connections)).transport)
        most = 0
        for _ in range(200):  # 12 MB
            server.take(LARGE)
            most = max(most, server.call(flow.get_write_buffer_size))
        assert 0 < most < 64 * len(LARGE) + 200_000
        assert until(lambda: server.hub.streams == 0)


def test_a_client_that_asks_nothing_is_cut_off(server: Running) -> None:
    with connect(server.port) as silent, connect(server.port, b"GET / HTTP/1.1\r\nHo") as slow:
        assert silent.recv(100) == b""
        assert slow.recv(100) == b""


def test_a_stream_is_not_cut_off_while_nothing_happens(server: Running) -> None:
    with connect(server.port, EVENTS) as client:
        assert until(lambda: server.hub.streams == 1)
        time.sleep(1.0)
        server.take(b'{"samples":[],"windows":[],"channel":"late"}\n')
        seen = b""
        while b'"channel":"late"' not in seen:
            seen += client.recv(65536)


def test_of_connections_beyond_the_most_the_longest_idle_ones_are_cut(
    server: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "REQUEST_S", 30.0)
    with connected(server.port, page.CONNECTIONS + 20) as clients:
        assert until(lambda: len(server.page.connections) <= page.CONNECTIONS)
        cut = 0
        for client in clients[:20]:
            try:
                cut += client.recv(1) == b""
            except ConnectionResetError:
                cut += 1
        assert cut == 20
    assert until(lambda: not server.page.connections)
    assert httpx.get(server.url).status_code == 200


def test_clients_that_send_a_byte_a_second_keep_nobody_from_the_page(
    server: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN 150 clients that send their requests byte by byte, and streams that nobody reads
    monkeypatch.setattr(page, "REQUEST_S", 30.0)
    monkeypatch.setattr(page, "STALLED_S", 30.0)
    with connected(server.port, 150, b"GET / HT") as slow, connected(server.port, STREAMS, EVENTS):
        for _ in range(3):
            for client in slow:
                with contextlib.suppress(OSError):  # cut meanwhile
                    client.sendall(b"T")
            # WHEN browsers come THEN each gets the page
            for _ in range(5):
                assert httpx.get(server.url, timeout=2.0).status_code == 200
        assert server.hub.streams <= STREAMS


def test_streams_beyond_the_most_are_told_to_come_later(server: Running) -> None:
    with connected(server.port, STREAMS, EVENTS):
        assert until(lambda: server.hub.streams == STREAMS)
        assert httpx.get(server.url + "events").status_code == 503
        assert httpx.get(server.url).status_code == 200
    assert until(lambda: server.hub.streams == 0)


def test_a_request_that_does_not_end_is_refused(server: Running) -> None:
    line = b"GET / HTTP/1.1\r\nHost: localhost\r\nCookie: " + b"x" * 40_000
    with connect(server.port, line) as client:
        assert client.recv(100).startswith((b"HTTP/1.1 400", b"HTTP/1.1 431"))
