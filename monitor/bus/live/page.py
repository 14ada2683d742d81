"""The page and its stream of events over HTTP: read only, and bounded whatever clients do.

A connection serves one request. A client that has not asked completely, or does not read, is idle.
A new client takes the place of the one that is idle for longest: a browser asks at once, so clients
that send a byte a second cannot keep it out.
"""

import asyncio
import re
from asyncio import StreamReader, StreamWriter
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from importlib.resources import files
from pathlib import PurePath
from typing import Final

from monitor.bus.live.hub import STREAMS, Hub

CONNECTIONS: Final = 100
REQUEST_S: Final = 10.0  # time for a request to arrive completely
STALLED_S: Final = 20.0  # time for a client to read
REQUEST_BYTES: Final = 16 << 10  # most bytes of request line and headers
METHODS: Final = ("GET", "HEAD")
EVENTS: Final = "/events"
FILES: Final = {  # path on the page: file of the package
    "/": "bus/live/static/live.html",
    **{
        f"/{name}": f"bus/live/static/{name}"
        for name in ("live.css", "live.js", "plots.js", "panels.js", "icon.svg")
    },
    **{f"/{name}": f"report/static/{name}" for name in ("draw.css", "draw.js", "report.css")},
    "/uplot.css": "report/static/uplot/uPlot.min.css",
    "/uplot.js": "report/static/uplot/uPlot.iife.min.js",
}
HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_TEXT: Final = "text/plain; charset=utf-8"
_STREAM: Final = "text/event-stream; charset=utf-8"
_TOKEN: Final = r"[!#$%&'*+.^_`|~0-9A-Za-z-]+"
_LINE: Final = re.compile(rf"({_TOKEN}) ([!-~]+) HTTP/1\.[01]")
_HEADER: Final = re.compile(rf"({_TOKEN}):[ \t]*([^\0\r\n]*?)[ \t]*")


class Page:
    """Answers the browsers of one hub.

    may_ask : returns whether a Host header names this page
    """

    def __init__(self, hub: Hub, may_ask: Callable[[str], bool]) -> None:
        self._hub, self._may_ask = hub, may_ask
        package = files("monitor")
        self._bodies = {path: package.joinpath(name).read_bytes() for path, name in FILES.items()}
        self.connections: set[StreamWriter] = set()
        self._idle: dict[StreamWriter, None] = {}  # the longest idle one first

    async def serve(self, reader: StreamReader, writer: StreamWriter) -> None:
        """Serve one connection; the callback of ``asyncio.start_server``."""
        self.connections.add(writer)
        if len(self.connections) > CONNECTIONS:
            self._cut(next(iter(self._idle), writer))
        try:
            with suppress(OSError, TimeoutError, asyncio.IncompleteReadError):
                await self._serve(reader, writer)
                writer.close()
                async with self._idling(writer, STALLED_S):
                    await writer.wait_closed()
        finally:
            self._cut(writer)

    def _cut(self, writer: StreamWriter) -> None:
        self.connections.discard(writer)
        self._idle.pop(writer, None)
        writer.transport.abort()

    @asynccontextmanager
    async def _idling(self, writer: StreamWriter, seconds: float) -> AsyncIterator[None]:
        """Let the client be idle for so long; raises TimeoutError."""
        self._idle[writer] = None
        try:
            async with asyncio.timeout(seconds):
                yield
        finally:
            self._idle.pop(writer, None)

    async def _serve(self, reader: StreamReader, writer: StreamWriter) -> None:
        method = ""
        try:
            async with self._idling(writer, REQUEST_S):
                head = await reader.readuntil(b"\r\n\r\n")
            method, path, headers = parsed(head.decode("latin-1"))
            answer = self.answer(method, path, headers)
        except (asyncio.LimitOverrunError, ValueError):
            answer = PageAnswer(HTTPStatus.BAD_REQUEST, b"This is no request.\n")
        await self._send(writer, answer.head + (b"" if method == "HEAD" else answer.body))
        if answer.is_stream and method == "GET":
            await self._stream(reader, writer)

    def answer(self, method: str, path: str, headers: Mapping[str, str]) -> "PageAnswer":
        """Return the answer to a request; names of headers are in small letters."""
        if refusal := self._refusal(method, path, headers):
            return refusal
        if path in self._bodies:
            kind = _TYPES[PurePath(FILES[path]).suffix]
            return PageAnswer(HTTPStatus.OK, self._bodies[path], kind)
        if path != EVENTS:
            return PageAnswer(HTTPStatus.NOT_FOUND, b"Not found.\n")
        if method == "GET" and self._hub.streams >= STREAMS:
            text, later = b"%d browsers watch already.\n" % STREAMS, {"Retry-After": "10"}
            return PageAnswer(HTTPStatus.SERVICE_UNAVAILABLE, text, more=later)
        return PageAnswer(HTTPStatus.OK, b"retry: 1000\n\n", _STREAM)

    def _refusal(self, method: str, path: str, headers: Mapping[str, str]) -> "PageAnswer | None":
        if not self._may_ask(headers.get("host", "")):
            text = b"This page is not served under that name.\n"
            return PageAnswer(HTTPStatus.MISDIRECTED_REQUEST, text)
        if method not in METHODS:
            allow = {"Allow": ", ".join(METHODS)}
            return PageAnswer(HTTPStatus.METHOD_NOT_ALLOWED, b"Read only.\n", more=allow)
        # another site's page cannot read this one, but it could occupy all its streams
        if path == EVENTS and headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return PageAnswer(HTTPStatus.FORBIDDEN, b"Not from another site.\n")
        return None

    async def _stream(self, reader: StreamReader, writer: StreamWriter) -> None:
        """Send events until the browser leaves or the loop ends; open streams are counted."""
        self._hub.streams += 1
        tasks = [asyncio.ensure_future(each) for each in (self._tell(writer), _left(reader))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._hub.streams -= 1
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _tell(self, writer: StreamWriter) -> None:
        place: int | None = None
        while place is None or not self._hub.ended:
            place, events = await self._hub.after(place)
            await self._send(writer, events)

    async def _send(self, writer: StreamWriter, data: bytes) -> None:
        writer.write(data)
        async with self._idling(writer, STALLED_S):
            await writer.drain()


@dataclass(frozen=True, slots=True)
class PageAnswer:
    """One answer; that of a stream has no end."""

    status: HTTPStatus
    body: bytes
    kind: str = _TEXT
    more: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_stream(self) -> bool:
        """Return whether events follow."""
        return self.kind == _STREAM

    @property
    def head(self) -> bytes:
        """Return status line and headers."""
        headers = {**HEADERS, "Content-Type": self.kind, **self.more}
        if not self.is_stream:
            headers["Content-Length"] = str(len(self.body))
        lines = [f"HTTP/1.1 {self.status.value} {self.status.phrase}"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        return "\r\n".join([*lines, "", ""]).encode("latin-1")


def parsed(head: str) -> tuple[str, str, dict[str, str]]:
    """Return method, path and headers of a request, names of headers in small letters.

    Raises ValueError if it is no request.

    >>> parsed("GET /x?a=1 HTTP/1.1\\r\\nHost: a\\r\\n\\r\\n")
    ('GET', '/x', {'host': 'a'})
    """
    first, *lines = head.removesuffix("\r\n\r\n").split("\r\n")
    asked, fields = _LINE.fullmatch(first), [_HEADER.fullmatch(line) for line in lines]
    found = {each[1].lower(): each[2] for each in fields if each}
    if not asked or len(found) < len(lines):  # a header that is none, or comes twice
        raise ValueError(f"no request: {first!r}")
    return asked[1], asked[2].partition("?")[0], found


async def _left(reader: StreamReader) -> None:
    """Wait until the client closes its side; what it sends is let go."""
    while await reader.read(REQUEST_BYTES):
        pass
