"""The option ``--live`` of ``o2mon run``: a web page that shows the monitor at work."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from monitor.bus.live.address import PageAddress, parse

if TYPE_CHECKING:
    from monitor.bus.live.feed import LiveFeed
    from monitor.bus.loop import Loop
    from monitor.pipeline.replay import Setup


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """The live page.

    live : serve a live page at this address; PORT alone means 127.0.0.1:PORT
    """

    live: Annotated[PageAddress | None, parse, "HOST:PORT"] = None


def live_feed(
    args: LiveOptions, setup: "Setup", loop: "Loop", channel: str, say: Callable[[str], None]
) -> "Iterator[LiveFeed]":
    """Start the page's server if ``--live`` is given, say its address and yield what feeds it.

    Raises UsageError if the server cannot start.
    """
    if args.live is None:
        return
    from monitor.bus.live.feed import LiveFeed
    from monitor.bus.live.process import Server

    server = Server(args.live)
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
