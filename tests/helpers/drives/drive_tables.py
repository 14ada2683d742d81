"""Tables of a recorded healthy drive, some of whose columns are changed."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from monitor.base import config
from monitor.pipeline.recordings import RecordingReader
from monitor.pipeline.replay import Setup, set_up
from tests.conftest import ROOT
from training.fleet.reading import Read, samples_of
from training.fleet.worker_kit import Tools
from training.recordings.files.table_files import write_table

PERIOD_S = 0.1
Columns = dict[str, np.ndarray]


def read(log: Path | str, setup: Setup) -> Read:
    """Return a whole replay log, or any other, with the signals that the monitor looks at."""
    reader = RecordingReader(setup.bus_map, setup.model.card)
    tools = Tools(setup.model, setup.limits, setup.config, reader, columns=None, folder=None)
    return samples_of(ROOT / "replay_logs" / log, tools)


@cache
def _healthy() -> Read:
    return read("healthy_micro_trips_v102_s102.blf", set_up(None, [], config.load()))


def columns() -> Columns:
    """Return the healthy drive of seven minutes, column by column."""
    drive = _healthy()
    return {name: drive.block.values[:, i].copy() for i, name in enumerate(drive.names)}


def table(path: Path, change: Callable[[Columns], None] = lambda _: None) -> Path:
    """Write the drive as a table after a change, also of ``time_s``; blank cells have no value."""
    data = columns()
    data = {"time_s": PERIOD_S * np.arange(len(data["lambda_measured"]))} | data
    change(data)
    t_s = data.pop("time_s")
    write_table(path, t_s, list(data), np.column_stack(list(data.values())))
    return path
