"""``o2mon map``: propose a signal map for a CAN database."""

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import Input, LogChannel, Number
from monitor.cli.options import NOT_JUDGED, say

EXAMPLES = """examples:
  o2mon map engine.dbc                             print a signal map
  o2mon map engine.dbc --out engine.toml           write it, to confirm line by line
  o2mon map engine.dbc --log drive.log --out engine.toml   check the proposals with a recording

Uncertain and ambiguous proposals are commented out. Check every proposal yourself: o2mon check
shows the values of the signals.

exit code: 0 every signal of the shipped model is proposed, 3 a signal is missing"""


def run(
    dbc: Annotated[Input, "DBC"],
    *,
    out: Annotated[Path | None, paths.written, "MAP.toml"] = None,
    log: Input | None = None,
    of: LogChannel,
    cylinders: Number = 4,
) -> int:
    """Propose a signal map for a CAN database.

    dbc : CAN database
    out : signal map to write (default: print it)
    log : recording of a drive that checks the proposals
    cylinders : cylinders, to convert flows to fuel and air per stroke
    """
    from monitor.base.errors import UsageError
    from monitor.base.files.outputs import write_text
    from monitor.frames.text.python_can import import_without_mdf

    import_without_mdf()
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from monitor.decode.bus_map import read_database
    from monitor.mapping.map_proposal import make_map

    if cylinders < 1:
        raise UsageError("--cylinders is at least 1")
    database, notes = read_database(dbc)
    text, proposals = make_map(
        database, dbc, log=log, channel=of.channel, cylinders=cylinders, notes=notes
    )
    tell = say if out else partial(print, file=sys.stderr)  # the map goes to stdout
    if out is None:
        say(text.rstrip("\n"))
    else:
        write_text(out, text)
    missing = [name for name in (*NARX_INPUTS, OUTPUT) if name not in proposals.names]
    lines = [*(f"database: {note}" for note in notes)]
    lines += [f"proposed: {', '.join(proposals.names) or 'nothing'}"]
    lines += [f"not proposed, though a model needs it: {', '.join(missing)}"] if missing else []
    for each in (p for p in proposals.signals if p.name in missing and p.ranked):
        lines += [f"  {each.name} stands as a comment, perhaps {each.ranked[0].place}: {each.note}"]
    check = f"  o2mon check LOG --dbc {dbc} --map {out}"
    tell("\n".join([*lines, *([f"confirm every line of {out}, then:", check] if out else [])]))
    return NOT_JUDGED if missing else 0
