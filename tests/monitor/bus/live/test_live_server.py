"""What the live page's server answers, and what it refuses."""

import argparse
import asyncio
import json
from typing import Any

import httpx
import pytest

from monitor.bus.live.address import PageAddress, is_loopback, listen, may_ask, parse
from monitor.bus.live.hub import RING, SAMPLES, WINDOWS, Hub
from monitor.bus.live.page import FILES, HEADERS, Page

HOST = "127.0.0.1"


class Client:
    """Asks the page over a socket; each request has a server of its own."""

    def __init__(self, hub: Hub | None = None, *, loopback: bool = True) -> None:
        self._page = Page(hub or Hub(), lambda header: may_ask(header, HOST, loopback=loopback))

    def request(self, method: str, path: str, **headers: str) -> httpx.Response:
        async def ask() -> httpx.Response:
            async with await asyncio.start_server(self._page.serve, HOST, 0) as server:
                port = server.sockets[0].getsockname()[1]
                async with httpx.AsyncClient() as client:
                    url = f"http://{HOST}:{port}{path}"
                    return await client.request(method, url, headers=headers)

        return asyncio.run(ask())

    def get(self, path: str, **headers: str) -> httpx.Response:
        return self.request("GET", path, **headers)


def message(**more: Any) -> bytes:
    return json.dumps({"samples": [], "windows": [], **more}).encode() + b"\n"


@pytest.mark.parametrize("path", FILES)
def test_every_file_of_the_page_is_served_with_its_type(path: str) -> None:
    answer = Client().get(path)
    assert answer.status_code == 200
    assert len(answer.content) > 100
    kind = answer.headers["content-type"].split(";")[0]
    wanted = {"css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
    assert kind == wanted.get(path.rpartition(".")[2], "text/html")


@pytest.mark.parametrize("path", ["/", "/live.js", "/nothing", "/events"])
def test_every_answer_has_the_headers(path: str) -> None:
    answer = Client().request("HEAD", path)
    for name, value in HEADERS.items():
        assert answer.headers[name] == value
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "BREW"])
def test_whatever_could_write_is_refused(method: str) -> None:
    answer = Client().request(method, "/events")
    assert answer.status_code == 405
    assert answer.headers["allow"] == "GET, HEAD"
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_what_is_not_there_is_not_found() -> None:
    for path in ("/nothing", "/static/live.js", "/../../etc/passwd", "/live.js/", "/%2e%2e/x"):
        assert Client().get(path).status_code == 404, path


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
    answer = Client(loopback=loopback).get("/", host=header)
    assert answer.status_code == (200 if wanted else 421)


@pytest.mark.parametrize("site", ["cross-site", "same-site", "?"])
def test_another_site_cannot_use_up_the_streams(site: str) -> None:
    answer = Client().get("/events", **{"sec-fetch-site": site})
    assert answer.status_code == 403


def test_a_browser_that_comes_gets_the_past_at_once() -> None:
    hub = Hub()
    hub.take(message(channel="vcan0", samples=[[0, 1.0, 1.01, 4095]], now={"ms": 0}))
    hub.take(message(samples=[[100, 1.1, 1.02, 4095]], now={"ms": 100}))
    hub.end()  # so that the stream ends
    answer = Client(hub).get("/events")
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
