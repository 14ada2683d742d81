"""Options of ``o2mon run`` and ``o2mon replay`` that send results to other systems."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from monitor.base.command_line.signature import REPEATED
from monitor.cli.options import Hertz

if TYPE_CHECKING:
    from monitor.bus.loop import Loop
    from monitor.bus.sink_feed import SinkFeed
    from monitor.sinks.outlet import Outlet
    from monitor.sinks.written import Written


def _tag(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (equals and value and name.isidentifier() and name.isascii()):
        raise argparse.ArgumentTypeError(f"{text}: NAME=TEXT is wanted, NAME of letters and digits")
    return name, value


@dataclass(frozen=True, kw_only=True)
class SinkOptions:
    """Where results go.

    sink : send events and signals there: mqtt://HOST/TOPIC, jsonl:FILE (lines of JSON, - for the
        output), or the kind of a plug-in; may repeat
    sink_rate : most signal records per second
    sink_tag : tag of everything that is sent, as vehicle=17; may repeat
    """

    sink: Annotated[Sequence[str], REPEATED, "ADDRESS"] = ()
    sink_rate: Hertz = 1.0
    sink_tag: Annotated[Sequence[tuple[str, str]], REPEATED, _tag, "NAME=TEXT"] = ()


@contextmanager
def outlets(args: SinkOptions) -> "Iterator[list[Outlet]]":
    """Open the sinks of a run, each with its thread, and close them at the end.

    Raises UsageError if one cannot be had.
    """
    if not args.sink:
        yield []
        return
    from monitor.sinks.address import open_sink, shown
    from monitor.sinks.outlet import Outlet

    sinks = [open_sink(address, dict(args.sink_tag)) for address in args.sink]
    opened = [Outlet(shown(a), sink) for a, sink in zip(args.sink, sinks, strict=True)]
    try:
        yield opened
    finally:
        for outlet in opened:
            outlet.close()


def sink_feed(
    args: SinkOptions, opened: "list[Outlet]", loop: "Loop", say: Callable[[str], None]
) -> "list[SinkFeed]":
    """Return the attachment that feeds the sinks, in a list; an empty list if there are none."""
    if not opened:
        return []
    from monitor.bus.sink_feed import SinkFeed
    from monitor.sinks.stream import Stream

    stream = Stream(loop.pipeline.monitor, args.sink_rate)
    return [SinkFeed(stream, opened, loop.health, say)]


def written_sinks(args: SinkOptions) -> "Written | None":
    """Return the sinks of a replay, None without any; a replay waits for them.

    Raises UsageError if one cannot be had.
    """
    if not args.sink:
        return None
    from monitor.sinks.address import open_sink, shown
    from monitor.sinks.written import Written

    tags = dict(args.sink_tag)
    return Written(
        {shown(address): open_sink(address, tags) for address in args.sink}, args.sink_rate
    )
