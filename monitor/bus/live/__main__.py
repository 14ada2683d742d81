"""The server process: ``python -m monitor.bus.live SOCKET HOST``, started by the keeper.

It reads the loop's messages from standard input and ends with it.
"""

import asyncio
import socket
import sys
from typing import Final

import uvicorn

from monitor.bus.live.address import is_loopback, may_ask
from monitor.bus.live.app import create_app
from monitor.bus.live.hub import Hub
from monitor.bus.live.process import GREETING
from monitor.bus.live.protocol import REQUEST_BYTES, BoundedProtocol

LINE_BYTES: Final = 4 << 20  # longest message


def main() -> None:
    """Serve until the loop closes the pipe."""
    number, host = int(sys.argv[1]), sys.argv[2]
    with socket.socket(fileno=number) as listening:
        hub = Hub()
        server = server_of(hub, host, loopback=is_loopback(listening))
        asyncio.run(serve(server, hub, listening))


def server_of(hub: Hub, host: str, *, loopback: bool) -> uvicorn.Server:
    """Return the server of a hub's page.

    host : host that the user asked to listen on
    loopback : only this machine can reach the server
    """
    config = uvicorn.Config(
        create_app(hub, lambda header: may_ask(header, host, loopback=loopback)),
        http=BoundedProtocol,
        ws="none",
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        h11_max_incomplete_event_size=REQUEST_BYTES,
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)


async def serve(server: uvicorn.Server, hub: Hub, listening: socket.socket) -> None:
    """Run the server and the reader of the loop's messages."""
    reading = asyncio.create_task(read(hub))
    reading.add_done_callback(lambda _: setattr(server, "should_exit", True))
    await server.serve([listening])
    if reading.done():
        reading.result()  # raises the reader's error, if there is one
    reading.cancel()


async def read(hub: Hub) -> None:
    """Pass every message to the hub until the pipe is closed.

    The first message is a greeting; earlier ones were meant for a server that has died.
    """
    reader = asyncio.StreamReader(limit=LINE_BYTES)
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin.buffer)
    is_greeted = False
    try:
        while line := await reader.readline():
            is_greeted = is_greeted or line.startswith(GREETING)
            if is_greeted and line.endswith(b"\n"):  # a dying loop may cut its last message
                hub.take(line)
    finally:
        hub.end()


if __name__ == "__main__":
    main()
