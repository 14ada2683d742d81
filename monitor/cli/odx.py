"""``o2mon odx``: describe the diagnostic server for testers that read ODX."""

import argparse
from typing import Any

from monitor.base import option_paths as paths
from monitor.cli.options import add_command, say

HELP = "write the ODX description of the diagnostics"
_ODX = """examples:
  o2mon odx monitor.pdx              services, identifiers and codes as ODX 2.2, for a tester

exit code: 0 written, 2 the file cannot be written"""


def add(commands: Any) -> None:
    """Add the subcommand ``odx``."""
    parser = add_command(commands, "odx", HELP, _ODX, _odx)
    parser.add_argument("out", type=paths.written, metavar="FILE.pdx", help="file to write")


def _odx(args: argparse.Namespace) -> int:
    from monitor.base.outputs import write_bytes
    from monitor.bus.odx.description import pdx

    write_bytes(args.out, pdx())
    say(f"description: {args.out}")
    return 0
