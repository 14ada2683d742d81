"""The option ``--live`` of ``o2mon run``: a web page that shows the monitor at work."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from monitor.bus.live.address import PageAddress, parse

if TYPE_CHECKING:
    from monitor.bus.live.feed import LiveFeed
    from monitor.bus.live.process import Server
    from monitor.bus.loop import Loop
    from monitor.pipeline.replay import Setup


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """The live page.

    live : serve a live page at this address; PORT alone means 127.0.0.1:PORT
    """

    live: Annotated[PageAddress | None, parse, "HOST:PORT"] = None


@contextmanager
def live_server(args: LiveOptions) -> "Iterator[Server | None]":
    """Start the page's server if ``--live`` is given, and stop it at the end.

    Raises UsageError if the server cannot start.
    """
    if args.live is None:
        yield None
        return
    from monitor.bus.live.process import Server

    server = Server(args.live)
    try:
        yield server
    finally:
        server.close()


def live_feed(
    server: "Server | None", setup: "Setup", loop: "Loop", channel: str, say: Callable[[str], None]
) -> "Iterator[LiveFeed]":
    """Yield the attachment that feeds the page, and say the page's address."""
    if server is None:
        return
    from monitor.bus.live.feed import LiveFeed

    say(f"live page: {server.address.url}")
    if not server.is_loopback:
        say(f"warning: everyone who reaches {server.address.host} can read the live page")
    yield LiveFeed(
        server,
        loop.pipeline.monitor,
        setup,
        health=lambda: loop.health.as_dict() | loop.pipeline.counters | loop.clock.counters.found,
        channel=channel,
        say=say,
    )
