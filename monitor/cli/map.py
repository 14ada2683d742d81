"""``o2mon map``: propose a signal map for a CAN database."""

import argparse
import sys
from typing import Any

from monitor.base.command_line import option_paths as paths
from monitor.cli.options import NOT_JUDGED, add_command, say

HELP = "propose a signal map for a CAN database"
_MAP = """examples:
  o2mon map engine.dbc                             print a signal map
  o2mon map engine.dbc --out engine.toml           write it, to confirm line by line
  o2mon map engine.dbc --log drive.log --out engine.toml   check the proposals with a recording

Uncertain and ambiguous proposals are commented out. Check every proposal yourself: o2mon check
shows the values of the signals.

exit code: 0 every signal of the shipped model is proposed, 3 a signal is missing"""


def add(commands: Any) -> None:
    """Add the subcommand ``map``."""
    parser = add_command(commands, "map", HELP, _MAP, _map)
    parser.add_argument("dbc", type=paths.read, metavar="DBC", help="CAN database")
    parser.add_argument(
        "--out",
        type=paths.written,
        metavar="MAP.toml",
        help="signal map to write (default: print it)",
    )
    parser.add_argument(
        "--log", type=paths.read, help="recording of a drive that checks the proposals"
    )
    parser.add_argument(
        "--cylinders",
        type=int,
        default=4,
        metavar="N",
        help="cylinders, to convert flows to fuel and air per stroke (default: 4)",
    )
    parser.add_argument("--force", action="store_true", help="overwrite an existing --out")


def _map(args: argparse.Namespace) -> int:
    from monitor.base.errors import UsageError
    from monitor.base.files.outputs import check_new, write_text
    from monitor.frames.text.python_can import import_without_mdf

    import_without_mdf()
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from monitor.decode.bus_map import read_database
    from monitor.mapping.text import make_map

    if args.cylinders < 1:
        raise UsageError("--cylinders is at least 1")
    if args.out:
        check_new(args.out, force=args.force)
    database, notes = read_database(args.dbc)
    text, proposals = make_map(
        database, args.dbc, log=args.log, cylinders=args.cylinders, notes=notes
    )
    tell = say if args.out or args.nothing else _tell_apart
    if args.out is None:
        say(text.rstrip("\n"))
    else:
        write_text(args.out, text)
    missing = [name for name in (*NARX_INPUTS, OUTPUT) if name not in proposals.names]
    for note in notes:
        tell(f"database: {note}")
    tell(f"proposed: {', '.join(proposals.names) or 'nothing'}")
    if missing:
        tell(f"not proposed, though a model needs it: {', '.join(missing)}")
    if args.out:
        tell(f"confirm every line of {args.out}, then:")
        tell(f"  o2mon check LOG --dbc {args.dbc} --map {args.out}")
    return NOT_JUDGED if missing else 0


def _tell_apart(line: str) -> None:
    """Print to stderr, because the map goes to stdout."""
    print(line, file=sys.stderr)
