"""The command ``o2train table``: write a CAN log or measurement file as a table."""

from pathlib import Path
from typing import Annotated

from monitor.base.command_line import option_paths as paths
from training.cli.options import GridOptions, Names, tell_notes

EXAMPLES = """examples:
  o2train table drive.log --out drive.csv
  o2train table drive.blf --out drive.parquet --dbc my.dbc --map my.toml --period 0.05
  o2train table measurement.mf4 --out drive.csv.gz --columns channels.toml
"""


def run(
    recording: Annotated[Path, paths.recording],
    *,
    out: Annotated[Path, paths.written],
    signals: Names | None = None,
    reading: GridOptions,
) -> int:
    """Decode a recording and write it as a table on one sample grid, one column per signal.

    A cell without a valid value stays blank.

    recording : CAN log, table or measurement file
    out : table to write: .csv, .csv.gz or .parquet
    signals : signals to write (default: all)
    Raises RecordingError or UsageError (exit code 2).
    """
    from monitor.base.files.manifest import note
    from training.recordings.recording import load, write_table

    found = load(
        recording,
        signals,
        period_s=reading.period,
        pairs=reading.pairs or None,
        channel=reading.channel,
        columns=reading.columns,
    )
    tell_notes([found])
    write_table(out, found.t_s, found.names, found.values)
    note(out, recording)
    good = int((found.quality == 0).sum())
    print(
        f"{out}: {len(found.t_s)} samples of {found.period_ns / 1e9:g} s, "
        f"{len(found.names)} signals, {100 * good / max(found.quality.size, 1):.1f} % good"
    )
    return 0
