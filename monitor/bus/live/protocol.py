"""uvicorn's HTTP protocol with limits on connections, request size and waiting time."""

import asyncio
from typing import Final

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS: Final = 100
REQUEST_S: Final = 10.0  # time for a request to arrive completely
STALLED_S: Final = 20.0  # time for a client to read the response
REQUEST_BYTES: Final = 16 << 10  # most bytes of request line and headers


class BoundedProtocol(H11Protocol):
    """Aborts connections over the limit, without a request, or with a client that does not read.

    A new client takes the place of the one that has kept its place idle for longest: a browser asks
    at once, so clients that send a byte a second cannot keep it out.
    """

    _impatient: asyncio.TimerHandle | None = None
    _idle_s = (
        0.0  # since when it waits for a request, or for its client to read; of the loop's clock
    )
    _is_cut = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection; if there are too many, abort another that waits, or this one."""
        super().connection_made(transport)
        self._idle_s = self.loop.time()
        others = [each for each in self._accepted if each is not self]
        if len(others) >= CONNECTIONS:
            idle = [each for each in others if each.is_idle]
            min(idle, key=lambda each: each._idle_s, default=self).cut()
        if not self._is_cut:
            self._within(REQUEST_S)

    @property
    def _accepted(self) -> "list[BoundedProtocol]":
        found = (each for each in self.connections if isinstance(each, BoundedProtocol))
        return [each for each in found if not each._is_cut]

    @property
    def is_idle(self) -> bool:
        """Return whether the client has not asked completely, or does not read."""
        return self._waits or self.flow.write_paused

    @property
    def _waits(self) -> bool:
        return self.cycle is None or bool(self.cycle.response_complete)

    def cut(self) -> None:
        """End the connection at once."""
        self._is_cut = True
        self._calm()
        self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Take bytes from the client."""
        super().data_received(data)
        waits = self._waits
        if not waits and not self.flow.write_paused:
            self._calm()
        elif waits and self._impatient is None and self.conn.trailing_data[0]:
            self._within(REQUEST_S)  # the next request has begun

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._idle_s = self.loop.time()
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        """Answer 400 to a first request that is not HTTP; abort if an earlier one was valid.

        Its answer may have begun, and uvicorn would append a second one.
        """
        if self.cycle is None:
            super().send_400_response(msg)
            return
        self.cycle.disconnected = True
        self.transport.abort()

    def pause_writing(self) -> None:
        """Start the time limit of a client that does not read."""
        super().pause_writing()
        self._idle_s = self.loop.time()
        self._within(STALLED_S)

    def resume_writing(self) -> None:
        """Stop the time limit: the client reads again."""
        super().resume_writing()
        self._calm()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the time limit of a closed connection."""
        self._calm()
        super().connection_lost(exc)

    def _within(self, seconds: float) -> None:
        self._calm()
        self._impatient = self.loop.call_later(seconds, self.transport.abort)

    def _calm(self) -> None:
        if self._impatient is not None:
            self._impatient.cancel()
            self._impatient = None
