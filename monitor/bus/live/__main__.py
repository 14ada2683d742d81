"""The server process: ``python -m monitor.bus.live SOCKET HOST``, started by the keeper.

It reads the loop's messages from standard input and ends with it.
"""

import asyncio
import socket
import sys
from contextlib import suppress
from typing import Final

from monitor.bus.live.address import is_loopback, may_ask
from monitor.bus.live.hub import Hub
from monitor.bus.live.page import REQUEST_BYTES, Page
from monitor.bus.live.process import GREETING

LINE_BYTES: Final = 4 << 20  # longest message
END_S: Final = 1.0  # for the browsers to be told of the end


def main() -> None:
    """Serve until the loop closes the pipe."""
    number, host = int(sys.argv[1]), sys.argv[2]
    with socket.socket(fileno=number) as listening:
        hub, loopback = Hub(), is_loopback(listening)
        page = Page(hub, lambda header: may_ask(header, host, loopback=loopback))
        asyncio.run(serve(page, hub, listening))


async def serve(page: Page, hub: Hub, listening: socket.socket) -> None:
    """Serve the page and read the loop's messages until the pipe is closed."""
    server = await asyncio.start_server(page.serve, sock=listening, limit=REQUEST_BYTES)
    try:
        await read(hub)
    finally:
        hub.end()
        server.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(END_S):
                while hub.streams:
                    await asyncio.sleep(0.02)


async def read(hub: Hub) -> None:
    """Pass every message to the hub until the pipe is closed.

    The first message is a greeting; earlier ones were meant for a server that has died.
    """
    reader = asyncio.StreamReader(limit=LINE_BYTES)
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin.buffer)
    is_greeted = False
    while line := await reader.readline():
        is_greeted = is_greeted or line.startswith(GREETING)
        if is_greeted and line.endswith(b"\n"):  # a dying loop may cut its last message
            hub.take(line)


if __name__ == "__main__":
    main()
