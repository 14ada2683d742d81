"""A fleet on a real Dask cluster whose workers have nothing of this project installed."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from monitor.base import config
from monitor.base.errors import UsageError
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives import fleet_drives
from tests.helpers.drives.fleet_drives import assert_alike, judged, tables
from training.fleet import run as fleet
from training.fleet.drives import drives_of
from training.fleet.worker_kit import WorkerKit

# The project is installed, and its root may be on the path: neither is so for these processes.
_WITHOUT_US = """
import sys
from importlib.util import find_spec
from pathlib import Path
ours = Path(find_spec("monitor").origin).parents[1]
sys.path = [p for p in sys.path if Path(p or ".").resolve() != ours]
sys.meta_path = [f for f in sys.meta_path if "editable" not in getattr(f, "__module__", "")]
assert all(find_spec(name) is None for name in ("monitor", "training", "dbc"))
"""
_MAIN = """
import sys
from distributed.cli import {module}
sys.exit({module}.main())
"""


class Cluster:
    """A scheduler with its workers."""

    def __init__(self, address: str, workers: list[subprocess.Popen[bytes]]) -> None:
        self.address, self.workers = address, workers


@contextmanager
def cluster(folder: Path, workers: int = 2, *, installed: bool = False) -> Iterator[Cluster]:
    """Start scheduler and workers; they end with the context.

    installed : whether they find this project, or have only its dependencies
    """
    file = folder / "scheduler.json"
    log = (folder / "cluster.log").open("wb")
    where = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard"]

    def start(module: str, *options: str) -> subprocess.Popen[bytes]:
        script = ("" if installed else _WITHOUT_US) + _MAIN.format(module=module)
        command = [sys.executable, "-c", script, *where, *options]
        return subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)

    processes = [start("dask_scheduler", "--port", "0")]
    try:
        own = ("--nthreads", "1", "--no-nanny", "--local-directory", str(folder))
        processes += [start("dask_worker", *own) for _ in range(workers)]
        deadline = time.monotonic() + 60
        while not (file.exists() and file.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.05)
        yield Cluster(json.loads(file.read_text())["address"], processes[1:])
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait(10)
        log.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "drives"
    fleet_drives.small_fleet(folder, 24)
    return folder


@pytest.fixture(scope="module")
def local(folder: Path) -> tuple[pl.DataFrame, pl.DataFrame]:
    return judged([str(folder)], folder.parent / "local.parquet")


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster(tmp_path_factory.mktemp("dask")) as found:
        yield found


def test_a_cluster_gives_the_same_and_a_killed_worker_costs_only_time(
    folder: Path, local: tuple[pl.DataFrame, pl.DataFrame], dask: Cluster, tmp_path: Path
) -> None:
    # GIVEN a fleet on two workers
    out, chunks = tmp_path / "out.parquet", []

    def done(chunk: dict[str, Any]) -> None:
        # WHEN one of them is killed while it works
        if not chunks:
            dask.workers[0].send_signal(signal.SIGKILL)
        chunks.append(chunk["drives"])

    kit = WorkerKit.of(shipped_model(), config.load())
    fleet.run(drives_of([str(folder)]), kit, out, done, scheduler=dask.address)
    # THEN the other does its work, every chunk is there once, and the tables are the same
    assert dask.workers[0].wait(10) == -signal.SIGKILL
    assert chunks == [4] * 6
    assert_alike(tables(out), local)


def test_runs_that_share_a_cluster_do_not_end_each_other(
    folder: Path, local: tuple[pl.DataFrame, pl.DataFrame], dask: Cluster, tmp_path: Path
) -> None:
    # GIVEN a fleet on a cluster
    kit, drives = WorkerKit.of(shipped_model(), config.load()), drives_of([str(folder)])
    on_it, chunks = {"scheduler": dask.address}, []

    def done(chunk: dict[str, Any]) -> None:
        # WHEN another run begins and ends there meanwhile
        if not chunks:
            judged([str(next(folder.glob("*.parquet")))], tmp_path / "b.parquet", **on_it)
        chunks.append(chunk["drives"])

    fleet.run(drives, kit, tmp_path / "a.parquet", done, **on_it)
    # THEN the first goes on
    assert chunks == [4] * 6
    assert_alike(tables(tmp_path / "a.parquet"), local)


def test_a_scheduler_without_workers_is_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.jobs.cluster.CONNECT_S", 2.0)
    with (
        cluster(tmp_path, workers=0) as dask,
        pytest.raises(UsageError, match=f"scheduler {dask.address}: it has no worker"),
    ):
        judged([str(folder)], tmp_path / "out.parquet", scheduler=dask.address)
