"""A fleet on a real Dask cluster whose workers have nothing of this project installed."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from monitor.base import config
from monitor.base.errors import UsageError
from monitor.pipeline.replay import shipped_model
from tests.helpers.dask_cluster import Cluster, cluster
from tests.helpers.drives import fleet_drives
from tests.helpers.drives.fleet_drives import assert_alike, judged, tables
from training.fleet import run as fleet
from training.fleet.drives import drives_of
from training.fleet.worker_kit import WorkerKit


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
