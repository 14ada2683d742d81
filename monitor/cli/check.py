"""``o2mon check``: which signals are there."""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.cli.options import (
    NOT_JUDGED,
    add_bus,
    add_command,
    add_setup,
    bus_name,
    open_bus,
    positive,
    say,
    set_up,
)
from monitor.errors import UsageError

if TYPE_CHECKING:
    import can

    from monitor.types import Frame

_CHECK = """examples:
  o2mon check drive.log
  o2mon check -i socketcan -c can0 --seconds 10 --dbc engine.dbc --map engine.toml

exit code: 0 all the model needs is there, 3 something is missing"""


def add(commands: Any) -> None:
    """Add the subcommand."""
    check = add_command(commands, "check", "say which signals are there", _CHECK, _check)
    check.add_argument("log", nargs="?", type=Path, metavar="LOG", help="CAN log instead of a bus")
    add_bus(check)
    add_setup(check, memory=False)
    check.add_argument("--seconds", type=positive, default=5.0, help="how long to listen to a bus")


def _check(args: argparse.Namespace) -> int:
    from monitor.check import check
    from monitor.sources import read_frames

    if args.log and bus_name(args):
        raise UsageError("give either a LOG or a bus (-i, -c), not both")
    setup = set_up(args)
    if args.log:
        result = check(read_frames(args.log), setup.bus_map)
    else:
        with open_bus(args) as bus:
            result = check(_listen(bus, args.seconds), setup.bus_map)
    for line in result.lines():
        say(line)
    card = setup.model.card
    missing = result.missing((*card.input_names, card.output.name))
    say(f"the model lacks: {', '.join(missing)}" if missing else "the model has all it needs")
    return NOT_JUDGED if missing else 0


def _listen(bus: "can.BusABC", seconds: float) -> "Iterator[Frame]":
    from monitor.bus import receive
    from monitor.sources import frame_of

    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        message = receive(bus, left_s)
        if message is not None and not message.is_error_frame and not message.is_remote_frame:
            yield frame_of(message)
