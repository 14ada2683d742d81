"""uvicorn's HTTP protocol with limits on connections, request size and waiting time."""

import asyncio
from typing import Final

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS: Final = 100
REQUEST_S: Final = 10.0  # time for a request to arrive completely
STALLED_S: Final = 20.0  # time for a client to read the response
REQUEST_BYTES: Final = 16 << 10  # most bytes of request line and headers


class BoundedProtocol(H11Protocol):
    """Aborts connections over the limit, without a request, or with a client that does not read."""

    _impatient: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection, or abort it if there are too many."""
        super().connection_made(transport)
        if len(self.connections) > CONNECTIONS:
            transport.abort()
        else:
            self._within(REQUEST_S)

    def data_received(self, data: bytes) -> None:
        """Take bytes from the client."""
        super().data_received(data)
        waits = self.cycle is None or self.cycle.response_complete
        if not waits and not self.flow.write_paused:
            self._calm()
        elif waits and self._impatient is None and self.conn.trailing_data[0]:
            self._within(REQUEST_S)  # the next request has begun

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
