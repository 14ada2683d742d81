"""Options of ``o2mon run`` and ``o2mon replay`` that send results to other systems."""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TextIO

from monitor.base.command_line.signature import REPEATED
from monitor.base.errors import UsageError
from monitor.cli.options import Hertz

if TYPE_CHECKING:
    from monitor.bus.loop import Loop
    from monitor.bus.sink_feed import SinkFeed
    from monitor.sinks.record import Sink


STDOUT: Final = "jsonl:-"


def _tag(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (equals and value and name.isidentifier() and name.isascii()):
        raise argparse.ArgumentTypeError(f"{text}: NAME=TEXT is wanted, NAME of letters and digits")
    from monitor.base.signals import BY_NAME
    from monitor.sinks.record import FIELDS

    if name in FIELDS or name in BY_NAME:
        raise argparse.ArgumentTypeError(f"{text}: records have a {name} of their own")
    return name, value


@dataclass(frozen=True, kw_only=True)
class SinkOptions:
    """Where results go.

    sink : send events and signals there: mqtt://HOST/TOPIC, jsonl:FILE (lines of JSON; with
        jsonl:- on stdout, the command then speaks on stderr), or the kind of a plug-in; may repeat
    sink_rate : most signal records per second
    sink_tag : tag of everything that is sent, as vehicle=17; may repeat
    """

    sink: Annotated[Sequence[str], REPEATED, "ADDRESS"] = ()
    sink_rate: Hertz = 1.0
    sink_tag: Annotated[Sequence[tuple[str, str]], REPEATED, _tag, "NAME=TEXT"] = ()


def appended(args: argparse.Namespace) -> list[Path]:
    """Return the files to which the sinks append."""
    kinds = [address.partition(":")[::2] for address in args.sink if address != STDOUT]
    return [Path(place) for kind, place in kinds if kind.lower() == "jsonl"]


def spoken(args: SinkOptions) -> TextIO:
    """Return the stream for all that is no record."""
    return sys.stderr if STDOUT in args.sink else sys.stdout


def open_sinks(args: SinkOptions) -> "list[tuple[str, Sink]]":
    """Return the sinks and the names that messages show; they connect when they first write.

    Raises UsageError if one cannot be had.
    """
    if not args.sink and (args.sink_tag or args.sink_rate != 1.0):
        raise UsageError("--sink-tag and --sink-rate need --sink")
    from monitor.sinks.address import open_sink, shown

    return [(shown(address), open_sink(address, dict(args.sink_tag))) for address in args.sink]


def sink_feed(
    args: SinkOptions, sinks: "list[tuple[str, Sink]]", loop: "Loop", say: Callable[[str], None]
) -> "list[SinkFeed]":
    """Return the attachment that feeds the sinks, in a list; an empty list if there are none."""
    if not sinks:
        return []
    from monitor.bus.sink_feed import SinkFeed
    from monitor.sinks.outlet import Outlet
    from monitor.sinks.stream import Stream

    stream = Stream(loop.pipeline.monitor, args.sink_rate)
    return [SinkFeed(stream, [Outlet(name, sink) for name, sink in sinks], loop.health, say)]
