"""What in a damaged log explains a code that the healthy drive has not.

Frames carry a checksum and alive counters, so damage of a CAN log never changes what the ECU said,
and only one thing explains a code: frames were taken out for seconds while the rest of the log is
whole and in order. That is a silence. A table has no checksum: a changed number is believed. So is
the name of a column: without it the signal is made of others, and the report says so.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.damage.log_seeds import LOGGERS, LOGS, PROFILE
from monitor.frames.logs import read_frames
from monitor.grid.tables import Table, read_table

SILENCE_S = 2.0  # a shorter one has no code


class DriveContent:
    """The undamaged drive, to compare with; ``folder`` holds its files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def explained(self, path: Path, kind: str, codes: Sequence[str]) -> str:
        """Return what explains the codes of a damaged log, "" if nothing does.

        kind : of its format
        """
        if kind in LOGS:
            return self._silence(path) if set(codes) == {"U0100"} else ""
        return self._changed(path, kind)

    def _silence(self, path: Path) -> str:
        said = {(frame.can_id, frame.data) for frame in read_frames(self._folder / "seed.log")}
        frames = list(read_frames(path))
        t_s = np.array([frame.t_ns for frame in frames]) / 1e9
        pauses_s = np.diff(t_s)
        is_whole = all((frame.can_id, frame.data) in said for frame in frames)
        if is_whole and pauses_s.min() >= 0.0 and pauses_s.max() > SILENCE_S:
            return "frames taken out"
        return ""

    def _changed(self, path: Path, kind: str) -> str:
        profile = self._folder / PROFILE if kind in LOGGERS else None
        table = read_table(path, profile)
        healthy = read_table(self._folder / f"seed{kind}", profile)
        if self._numbers_changed(table, healthy):
            return "numbers changed"
        if set(table.columns.items()) != set(healthy.columns.items()):
            return "a column's name lost"
        return ""

    def _numbers_changed(self, table: Table, healthy: Table) -> bool:
        """Return whether a signal has other values than the healthy drive at the same time.

        A signal that comes from another column than in the healthy drive is left out.
        """
        there = np.searchsorted(healthy.t_ns, table.t_ns - 1_000_000)
        there = np.minimum(there, len(healthy.t_ns) - 1)
        for name, values in zip(table.names, table.values.T, strict=True):
            if name not in healthy.names or table.column_of(name) != healthy.column_of(name):
                continue
            wanted = healthy.values[there, healthy.names.index(name)]
            if not np.allclose(values, wanted, rtol=1e-5, atol=1e-6, equal_nan=True):
                return True
        return False
