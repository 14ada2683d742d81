"""Tables of a recorded healthy drive, some of whose columns are changed."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from monitor.base import config
from monitor.pipeline.recordings import RecordingReader
from monitor.pipeline.replay import Setup, set_up
from tests.conftest import ROOT
from training.fleet.reading import FleetReader, Read

PERIOD_S = 0.1
Columns = dict[str, np.ndarray]


def read(log: Path | str, setup: Setup) -> Read:
    """Return a whole replay log, or any other, with the signals that the monitor looks at."""
    card = setup.model.card
    reader = FleetReader(RecordingReader(setup.bus_map, card), card, setup.config, None)
    return reader.read(ROOT / "replay_logs" / log)


@cache
def _healthy() -> Read:
    return read("healthy_micro_trips_v102_s102.blf", set_up(None, [], config.load()))


def columns() -> Columns:
    """Return the healthy drive of seven minutes, column by column."""
    drive = _healthy()
    return {name: drive.block.values[:, i].copy() for i, name in enumerate(drive.names)}


@cache
def _cells(column: bytes) -> list[str]:
    return ["" if np.isnan(value) else f"{value:.9g}" for value in np.frombuffer(column)]


def table(path: Path, change: Callable[[Columns], None] = lambda _: None) -> Path:
    """Write the drive as a table after a change, also of ``time_s``; blank cells have no value."""
    data = columns()
    data = {"time_s": PERIOD_S * np.arange(len(data["lambda_measured"]))} | data
    change(data)
    rows = zip(*(_cells(column.tobytes()) for column in data.values()), strict=True)
    lines = [",".join(data), *map(",".join, rows)]
    path.write_text("\n".join(lines) + "\n")
    return path
