"""HTTP as uvicorn speaks it, with bounds on what a client can make the server hold."""

import asyncio
from typing import Final

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS: Final = 100
REQUEST_S: Final = 10.0  # for a request to come in completely
STALLED_S: Final = 20.0  # for a client to read what it was sent
REQUEST_BYTES: Final = 16 << 10  # of line and headers


class BoundedProtocol(H11Protocol):
    """Cuts off clients that are too many, that do not ask, or that do not read."""

    _impatient: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or refuse it when there are enough."""
        super().connection_made(transport)
        if len(self.connections) > CONNECTIONS:
            transport.abort()
        else:
            self._within(REQUEST_S)

    def data_received(self, data: bytes) -> None:
        """Take what the client sends."""
        super().data_received(data)
        waits = self.cycle is None or self.cycle.response_complete
        if not waits and not self.flow.write_paused:
            self._calm()
        elif waits and self._impatient is None and self.conn.trailing_data[0]:
            self._within(REQUEST_S)  # a further request has begun

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP; cut off a client that began with a request and went on so.

        Its answer has begun, perhaps, and uvicorn would put a second one behind it.
        """
        if self.cycle is None:
            super().send_400_response(msg)
            return
        self.cycle.disconnected = True
        self.transport.abort()

    def pause_writing(self) -> None:
        """Wait for a client that does not read, for a while."""
        super().pause_writing()
        self._within(STALLED_S)

    def resume_writing(self) -> None:
        """Go on, for the client reads again."""
        super().resume_writing()
        self._calm()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of the connection."""
        self._calm()
        super().connection_lost(exc)

    def _within(self, seconds: float) -> None:
        self._calm()
        self._impatient = self.loop.call_later(seconds, self.transport.abort)

    def _calm(self) -> None:
        if self._impatient is not None:
            self._impatient.cancel()
            self._impatient = None
