"""The page and its stream of events. It is read only: GET and HEAD."""

from collections.abc import AsyncIterator, Callable
from importlib.resources import files
from pathlib import PurePath
from typing import Final

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from monitor.bus.live.hub import STREAMS, Hub

METHODS: Final = ("GET", "HEAD")
FILES: Final = {  # path on the page: file of the package
    "/": "bus/live/static/live.html",
    "/live.css": "bus/live/static/live.css",
    "/live.js": "bus/live/static/live.js",
    "/plots.js": "bus/live/static/plots.js",
    "/panels.js": "bus/live/static/panels.js",
    "/icon.svg": "bus/live/static/icon.svg",
    "/report.css": "report/static/report.css",
    "/uplot.css": "report/static/uplot/uPlot.min.css",
    "/uplot.js": "report/static/uplot/uPlot.iife.min.js",
}
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
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
}


class Guard:
    """Refuses requests with another host, method or origin, and adds the security headers."""

    def __init__(self, app: ASGIApp, may_ask: Callable[[str], bool]) -> None:
        self._app, self._may_ask = app, may_ask

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        await (self._refusal(scope) or self._app)(scope, receive, guarded)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        if not self._may_ask(headers.get("host", "")):
            return PlainTextResponse("This page is not served under that name.\n", 421)
        if scope["method"] not in METHODS:
            return PlainTextResponse("Read only.\n", 405, {"Allow": ", ".join(METHODS)})
        # another site's page cannot read this one, but it could occupy all its streams
        asker = headers.get("sec-fetch-site", "none")
        if scope["path"] == "/events" and asker not in ("same-origin", "none"):
            return PlainTextResponse("Not from another site.\n", 403)
        return None


class EventStream(StreamingResponse):
    """Server-sent events for one browser; open streams are counted."""

    media_type = "text/event-stream"

    def __init__(self, hub: Hub) -> None:
        super().__init__(self._events(hub), headers={"X-Accel-Buffering": "no"})
        self._hub = hub

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until the browser disconnects or the loop ends."""
        self._hub.streams += 1
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._hub.streams -= 1

    @staticmethod
    async def _events(hub: Hub) -> AsyncIterator[bytes]:
        yield b"retry: 1000\n\n"
        place: int | None = None
        while True:
            place, events = await hub.after(place)
            yield events
            if hub.ended:
                return


def create_app(hub: Hub, may_ask: Callable[[str], bool]) -> ASGIApp:
    """Return the web application.

    may_ask : returns whether a Host header names this page
    """
    package = files("monitor")
    bodies = {path: package.joinpath(name).read_bytes() for path, name in FILES.items()}

    async def page(request: Request) -> Response:
        path = request.url.path
        kind = _TYPES[PurePath(FILES[path]).suffix]
        return Response(bodies[path], media_type=kind)

    async def events(request: Request) -> Response:
        if request.method == "HEAD":
            return Response(media_type=EventStream.media_type)
        if hub.streams >= STREAMS:
            text = f"{STREAMS} browsers watch already.\n"
            return PlainTextResponse(text, 503, {"Retry-After": "10"})
        return EventStream(hub)

    routes = [Route(path, page) for path in FILES] + [Route("/events", events)]
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return Guard(app, may_ask)
