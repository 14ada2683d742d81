"""The server process: ``python -m monitor.bus.live SOCKET HOST``, started by the loop.

It reads the loop's messages from standard input and ends with it.
"""

import asyncio
import os
import socket
import sys
from contextlib import suppress
from typing import Final

from monitor.bus.live.address import is_loopback, may_ask
from monitor.bus.live.hub import Hub
from monitor.bus.live.page import REQUEST_BYTES, Page

NICE: Final = 10  # below the loop
LINE_BYTES: Final = 4 << 20  # longest message
END_S: Final = 1.0  # for the browsers to be told of the end


def main() -> None:
    """Serve until the loop closes the pipe."""
    number, host = int(sys.argv[1]), sys.argv[2]
    step_back()
    with socket.socket(fileno=number) as listening:
        hub, loopback = Hub(), is_loopback(listening)
        page = Page(hub, lambda header: may_ask(header, host, loopback=loopback))
        asyncio.run(serve(page, hub, listening))


def step_back() -> None:
    """Give up a real-time priority inherited from the loop."""
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)


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
    """Pass every message to the hub until the pipe is closed."""
    reader = asyncio.StreamReader(limit=LINE_BYTES)
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin.buffer)
    while line := await reader.readline():
        if line.endswith(b"\n"):  # a dying loop may cut its last message
            hub.take(line)


if __name__ == "__main__":
    main()
