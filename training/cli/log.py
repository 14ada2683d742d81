"""The command ``o2train log``: write a table as a CAN log."""

from pathlib import Path
from typing import Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import BusFiles, ColumnNames, Input
from training.cli.options import Length, warn

EXAMPLES = """examples:
  o2train log drive.csv --out drive.log
  o2train log drive.parquet --out drive.blf --dbc rusefi.dbc --map rusefi.toml
"""


def run(
    table: Input,
    *,
    out: Annotated[Path, paths.written],
    start: Length | None = None,
    bus: BusFiles,
    names: ColumnNames,
) -> int:
    """Write the frames that an ECU with these signals would send.

    Every message comes at its cycle time and carries the values of the latest row. A signal that
    the table lacks is sent as not available.

    table : table with canonical column names
    out : log to write: .log, .asc, .blf, .csv, .trc or .mf4; text formats also with .gz
    start : time of the first row in the log in seconds (default: its time in the table)
    Raises RecordingError or UsageError (exit code 2).
    """
    from monitor.base.errors import UsageError
    from monitor.base.files.manifest import note
    from monitor.decode.bus_map import load_pairs
    from monitor.frames.blocks import LATEST_S
    from monitor.grid.tables import read_table
    from training.recordings.files.can_log import broadcast, write_log
    from training.recordings.recording import check_rows, default_pairs

    if start is not None and not 0.0 <= start < LATEST_S:
        raise UsageError(f"--start {start:g}: seconds from 0 to {LATEST_S:g} are wanted")
    read = read_table(table, names.columns)
    check_rows(table, read.t_ns)
    bus_map = load_pairs(bus.pairs or default_pairs())
    values = {name: read.values[:, i] for i, name in enumerate(read.names)}
    start_ns = None if start is None else round(start * 1e6) * 1000
    frames = broadcast(bus_map, read.t_ns, values, start_ns)
    write_log(out, frames)
    note(out, table)
    sent = sorted(set(read.names) & set(bus_map.channels))
    lost = sorted(set(bus_map.names) - set(sent))
    print(f"sent {', '.join(sent)}; not available: {', '.join(lost) or 'none'}")
    derived = sorted(set(read.names) & set(bus_map.derived))
    warn(f"{name} is derived on this bus and not sent" for name in derived)
    seconds = (int(frames.t_ns[-1]) - int(frames.t_ns[0])) / 1e9
    print(f"{out}: {len(frames.t_ns)} frames in {seconds:.1f} s")
    return 0
