"""Clients that are slow, silent or too many, against the server with short patience."""

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
from monitor.bus.live.address import PageAddress, listen, may_ask
from monitor.bus.live.hub import STREAMS, Hub
from monitor.bus.live.page import Page
from tests.helpers.bus.beside import beside
from tests.helpers.bus.live_player import until

LARGE = json.dumps({"samples": [[0, 1.0, 1.0, 1]] * 3000, "windows": []}).encode() + b"\n"


class Running:
    """The server in a thread of the test."""

    def __init__(self) -> None:
        self.hub = Hub()
        self.page = Page(self.hub, lambda header: may_ask(header, "127.0.0.1", loopback=True))
        self._loop, self._ended = asyncio.new_event_loop(), asyncio.Event()
        listening = listen(PageAddress("127.0.0.1", 0))
        self.port = listening.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/"

        async def serve() -> None:
            limit = page.REQUEST_BYTES
            async with await asyncio.start_server(self.page.serve, sock=listening, limit=limit):
                await self._ended.wait()
                while self.page.connections:
                    await asyncio.sleep(0.01)

        self._thread = threading.Thread(target=lambda: self._loop.run_until_complete(serve()))
        self._thread.start()
        httpx.get(self.url)

    def take(self, *lines: bytes) -> None:
        self.call(lambda: [self.hub.take(line) for line in lines])

    def call(self, function: Any) -> Any:
        done: Future[Any] = Future()
        self._loop.call_soon_threadsafe(lambda: done.set_result(function()))
        return done.result(5.0)

    def stop(self) -> None:
        self.call(lambda: self.hub.ended or self.hub.end())
        self.call(self._ended.set)
        self._thread.join(10.0)
        assert not self._thread.is_alive()
        self._loop.close()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:
    monkeypatch.setattr(page, "REQUEST_S", 0.5)
    monkeypatch.setattr(page, "STALLED_S", 0.5)
    running = Running()
    yield running
    running.stop()


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
