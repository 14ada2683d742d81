"""The server process: ``python -m monitor.bus.live HOST PORT``, started by the loop.

It says in a line of JSON where it listens or why it cannot, reads the loop's messages from standard
input and ends with it.
"""

import asyncio
import json
import os
import socket
import sys
from contextlib import suppress
from typing import Final

from monitor.base.errors import UsageError
from monitor.bus.live.address import PageAddress, is_loopback, listen, may_ask
from monitor.bus.live.hub import Hub
from monitor.bus.live.page import REQUEST_BYTES, Page

NICE: Final = 10  # below the loop
END_S: Final = 1.0  # for the browsers to be told of the end


def main() -> None:
    """Serve until the loop closes the pipe."""
    address = PageAddress(sys.argv[1], int(sys.argv[2]))
    step_back()
    try:
        listening = listen(address)
    except UsageError as error:
        print(json.dumps({"error": str(error)}))
        return
    with listening:
        hub, loopback = Hub(), is_loopback(listening)
        port = listening.getsockname()[1]
        print(json.dumps({"port": port, "is_loopback": loopback}), flush=True)
        page = Page(hub, lambda header: may_ask(header, address.host, loopback=loopback))
        asyncio.run(serve(page, hub, listening))


def step_back() -> None:
    """Give up a real-time priority inherited from the loop."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if sys.platform != "win32":
        os.nice(NICE)


async def serve(page: Page, hub: Hub, listening: socket.socket) -> None:
    """Serve the page and read the loop's messages until the pipe is closed."""
    server = await asyncio.start_server(page.serve, sock=listening, limit=REQUEST_BYTES)
    try:
        await asyncio.to_thread(read, hub, asyncio.get_running_loop())  # Windows polls no pipe
    finally:
        hub.end()
        server.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(END_S):
                while hub.streams:
                    await asyncio.sleep(0.02)


def read(hub: Hub, loop: asyncio.AbstractEventLoop) -> None:
    """Pass every message to the hub until the pipe is closed."""
    for line in sys.stdin.buffer:
        if line.endswith(b"\n"):  # a dying loop may cut its last message
            loop.call_soon_threadsafe(hub.take, line)


if __name__ == "__main__":
    main()
