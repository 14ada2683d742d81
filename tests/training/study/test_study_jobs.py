"""The jobs of the NARX study: stored, killed and resumed, on a Dask cluster."""

import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from monitor.base.errors import UsageError
from tests.helpers.dask_cluster import cluster
from tests.helpers.small_study import FEW, SETTINGS, timeless, two_drives
from training.recordings.samples.preparation import Prepared
from training.study.narx.study import compared
from training.study.results import stored


@pytest.fixture(scope="module")
def data() -> Prepared:
    return two_drives()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def result(data: Prepared, folder: Path) -> dict[str, Any]:
    return compared(data, folder, SETTINGS, FEW, jobs=1)


def test_a_finished_job_is_not_repeated_and_other_settings_are(
    data: Prepared, result: dict[str, Any], folder: Path
) -> None:
    before = {p: p.stat().st_mtime_ns for p in folder.iterdir()}
    again = compared(data, folder, SETTINGS, FEW, jobs=1)
    assert {p: p.stat().st_mtime_ns for p in folder.iterdir()} == before
    assert timeless(again) == timeless(result)
    compared(data, folder, replace(SETTINGS, iterations=3, starts=1), FEW, jobs=1)
    assert len(list(folder.iterdir())) > len(before)


KILLED = """
import pickle, sys
from pathlib import Path
from training.study.narx.study import compared
data, settings, few = pickle.loads(Path(sys.argv[1]).read_bytes())
compared(data, Path(sys.argv[2]), settings, few, jobs=2)
"""


def test_a_killed_study_goes_on_where_it_was(
    data: Prepared, result: dict[str, Any], tmp_path: Path
) -> None:
    # GIVEN a study in its own process, killed after its first jobs
    (tmp_path / "data").write_bytes(pickle.dumps((data, SETTINGS, FEW)))
    folder = tmp_path / "jobs"
    command = [sys.executable, "-c", KILLED, str(tmp_path / "data"), str(folder)]
    study = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while len(list(folder.glob("train_*.json"))) < 2 and time.monotonic() < deadline:
        assert study.poll() is None
        time.sleep(0.002)
    workers = [p for p in children(study.pid) if "LokyProcess" in command_line(p)]
    study.send_signal(signal.SIGKILL)
    assert study.wait() == -signal.SIGKILL
    finished = {p: p.stat().st_mtime_ns for p in folder.glob("train_*.json")}
    # WHEN it is run again
    resumed = compared(data, folder, SETTINGS, FEW, jobs=1)
    # THEN finished jobs were left alone and the result is that of an undisturbed study
    assert 2 <= len(finished) < len(list(folder.glob("*.json")))
    assert {p: p.stat().st_mtime_ns for p in finished} == finished
    assert timeless(resumed) == timeless(result)
    # AND no worker outlives its study
    assert len(workers) == 2
    while any(command_line(p) for p in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(command_line(p) for p in workers)


def children(pid: int) -> list[int]:
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def test_a_half_written_job_does_not_count_as_finished(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"x": 1')
    assert stored(tmp_path / "a.json") is None


def test_a_dask_cluster_gives_the_same_study(
    data: Prepared, result: dict[str, Any], tmp_path: Path
) -> None:
    with cluster(tmp_path, workers=1, installed=True) as dask:
        found = compared(data, tmp_path / "jobs", SETTINGS, FEW, scheduler=dask.address)
    assert timeless(found) == timeless(result)


def test_a_scheduler_that_does_not_answer_is_named(
    data: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.jobs.cluster.CONNECT_S", 0.3)
    with pytest.raises(UsageError, match=r"scheduler tcp://127\.0\.0\.1:9: no answer"):
        compared(data, tmp_path, SETTINGS, FEW, scheduler="tcp://127.0.0.1:9")
