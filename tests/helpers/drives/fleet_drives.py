"""A small fleet: short drives of simulated vehicles as tables, and what reads their results."""

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from polars.testing import assert_frame_equal

from monitor.base import config
from monitor.pipeline.replay import shipped_model
from tests.conftest import ROOT
from training.fleet import run
from training.fleet.chunk_rows import Done
from training.fleet.drives import Chunk, drives_of
from training.fleet.worker_kit import WorkerKit
from training.jobs.worker import WorkerDiedError
from training.recordings.recording import Recording, load, write_table

LOGS = ROOT / "replay_logs"
HEALTHY = "healthy_micro_trips_v102_s102.blf"
DELAYED = "delay_rich_to_lean_micro_trips_v106_s108.blf"
PIECE = 1200  # samples of 0.1 s
Tables = tuple[pl.DataFrame, pl.DataFrame]  # recordings and windows of a run


@cache
def drive(name: str) -> Recording:
    return load(LOGS / name)


def write_piece(path: Path, name: str, first: int = 0, n: int = PIECE) -> Path:
    whole, piece = drive(name), slice(first, first + n)
    t_s = whole.t_s[piece] - whole.t_s[first]
    write_table(path, t_s, whole.names, whole.values[piece])
    return path


def small_fleet(folder: Path, drives: int = 10) -> list[Path]:
    """Write drives of two minutes, every fifth of them faulty, in two formats."""
    folder.mkdir(exist_ok=True)
    paths = []
    for i in range(drives):
        name = DELAYED if i % 5 == 4 else HEALTHY
        path = folder / f"drive_{i:03d}.{'csv.gz' if i % 2 else 'parquet'}"
        paths.append(write_piece(path, name, first=100 * (i % 20)))
    return paths


def run_deadly(
    function: Callable[[WorkerKit, Chunk], Done],
    kit: WorkerKit,
    items: Iterable[tuple[str, Chunk]],
    **_: Any,
) -> Iterator[tuple[str, Done]]:
    """Do jobs as ``parallel.run`` does where a file kills the process that judges it."""
    given, finished = dict(items), set[str]()
    for key, chunk in given.items():
        if any("deadly" in drive.path for own in chunk.vehicles for drive in own):
            raise WorkerDiedError(k for k in given if k not in finished)
        finished.add(key)
        yield key, function(kit, chunk)


def judged(given: list[str], out: Path, **options: Any) -> Tables:
    kit = WorkerKit.of(shipped_model(), config.load())
    options = {"jobs": 1} | options
    run.run(drives_of(given), kit, out, lambda _: None, **options)
    return tables(out)


def tables(out: Path) -> Tables:
    first, second = (pl.read_parquet(each, glob=False) for each in (out, run.windows_path(out)))
    return first, second


def assert_alike(a: tuple[pl.DataFrame, ...], b: tuple[pl.DataFrame, ...]) -> None:
    """Compare the tables of two runs, every bit of them."""
    for left, right in zip(a, b, strict=True):
        assert len(left) > 0
        assert_frame_equal(left, right, check_exact=True)


def close(a: object, b: object) -> bool:
    """Compare numbers of a table with those of a replay, which rounds to nine decimals."""
    return bool(np.allclose(np.array(a, float), np.array(b, float), rtol=0.0, atol=1e-9))
