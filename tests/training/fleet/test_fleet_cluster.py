"""A fleet on a real Dask cluster whose workers have nothing of this project installed."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from playwright.sync_api import Browser
from scipy import stats

import dbc
from monitor.base import config
from monitor.base.errors import UsageError
from monitor.base.types import FloatArray
from monitor.pipeline.replay import shipped_model
from tests.conftest import ROOT
from tests.helpers.bus.chromium import plots_of
from tests.helpers.drives import fleet_drives
from tests.helpers.drives.fleet_drives import Tables, assert_alike, judged, tables
from training.cli import main as o2train
from training.fleet import run as fleet
from training.fleet.drives import drives_of
from training.fleet.page import fleet_page, outliers, summary
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
def local(folder: Path) -> Tables:
    return judged([str(folder)], folder.parent / "local.parquet")


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster(tmp_path_factory.mktemp("dask")) as found:
        yield found


def test_a_cluster_gives_the_same_and_a_killed_worker_costs_only_time(
    folder: Path, local: Tables, dask: Cluster, tmp_path: Path
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
    folder: Path, local: Tables, dask: Cluster, tmp_path: Path
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


def of_vehicles(mean: FloatArray, gain: FloatArray, spread: FloatArray) -> pl.DataFrame:
    """Give the recordings of vehicles with one drive each."""
    return pl.DataFrame(
        {
            "vehicle": [f"v{i}" for i in range(len(mean))],
            "windows": np.full(len(mean), 50),
            "residual_mean": mean,
            "gain": gain,
            "residual_std": np.exp(spread),
        }
    )


@pytest.mark.parametrize("n", [12, 60])
def test_of_twenty_sound_fleets_one_has_a_vehicle_that_stands_out(n: int) -> None:
    # GIVEN fleets of sound vehicles with normally distributed values
    rng, fleets = np.random.default_rng(5), 1500
    limit = outliers.limit_of(n, 0.05, 3)
    drawn = outliers.robust(rng.standard_normal((fleets, 3, n)))
    # WHEN every vehicle is compared by three statistics
    events = int((np.abs(drawn).max(axis=(1, 2)) > limit).sum())
    # THEN the share of fleets with one that stands out is 5 %, as far as 1,500 fleets can tell
    low, high = stats.binom.ppf((0.005, 0.995), fleets, 0.05)
    assert low <= events <= high


def test_a_large_fleets_limit_is_that_of_known_spread() -> None:
    small = outliers.limit_of(outliers.MANY - 1)
    large = outliers.limit_of(outliers.MANY)
    assert large == pytest.approx(stats.norm.isf(0.05 / 2 / outliers.MANY), rel=0.01)
    assert small == pytest.approx(large, rel=0.06)


def test_reasons_that_differ_in_numbers_are_one_and_keep_the_numbers_that_are_alike() -> None:
    says = "period {} s, not 0.1 s; o2train table brings an .mf4 to one"
    paths, errors = ["a", "b"], [f"{p}: {says.format(s)}" for p, s in (("a", 1), ("b", 0.25))]
    (found,) = summary.reasons(pl.DataFrame({"path": paths, "error": errors}))
    assert found["reason"] == "period N s, not 0.1 s; o2train table brings an .mf4 to one"
    assert found["recordings"] == 2
    (alone,) = summary.reasons(pl.DataFrame({"path": paths[:1], "error": errors[:1]}))
    assert alone["reason"] == says.format(1)


def test_vehicles_far_from_the_fleet_stand_out_and_do_not_hide_each_other() -> None:
    rng = np.random.default_rng(1)
    mean, gain, spread = rng.standard_normal((3, 40))
    mean[:4] += 40.0  # a tenth of the fleet: the spread must not follow them
    gain[7] -= 12.0
    found = outliers.standings(of_vehicles(mean, gain, spread))
    assert set(outliers.named(found)) == {"v0", "v1", "v2", "v3", "v7"}
    assert [each.statistic.column for each in found] == ["residual_mean", "gain", "residual_std"]


def test_few_vehicles_are_not_compared() -> None:
    few = of_vehicles(*np.random.default_rng(2).standard_normal((3, 9)))
    assert outliers.standings(few) == []


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Give page and JSON of a fleet with short drives, faulty vehicles and empty files."""
    folder = tmp_path_factory.mktemp("fleet")
    drives = folder / "drives"
    fleet_drives.small_fleet(drives, 12)
    for i in range(2):
        (drives / f"empty_{i}.log").touch()
    kit, out = WorkerKit.of(shipped_model(), config.load()), folder / "out.parquet"
    run = fleet.run(drives_of([str(drives)]), kit, out, lambda _: None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(outliers, "LEAST_WINDOWS", 2)
        return fleet_page.write(out, kit, run, str)[:2]


def test_the_plots_of_a_fleet_are_drawn(reported: tuple[Path, Path], browser: Browser) -> None:
    assert plots_of(browser, reported[0]) == 3 + 6  # vehicles by three statistics, histograms


def test_the_report_shows_the_fleet_and_what_was_not_judged(reported: tuple[Path, Path]) -> None:
    # WHEN a fleet is reported
    html, tree = reported
    drives = html.parent / "drives"
    # THEN the figures say so
    found: dict[str, Any] = json.loads(tree.read_text())
    assert (found["schema"], found["drives"], found["judged"]) == ("o2train.fleet/1", 14, 12)
    examples = [str(drives / f"empty_{i}.log") for i in range(2)]
    empty = {"reason": "the log is empty", "recordings": 2, "examples": examples}
    assert found["not_judged"] == [empty]
    (code,) = found["codes"]
    assert (code["code"], code["drives"]) == ("P015A", 2)
    assert code["examples"] == ["drive_004.parquet", "drive_009.csv.gz"]
    assert found["hours"] == pytest.approx(12 * 0.0333, rel=0.01)
    assert found["per_1000_h"]["core_seconds"]["all"] > 0.0
    assert {each["vehicles"] for each in found["standing_out"]["statistics"]} == {12}
    # AND the page shows it with pictures, loading nothing from elsewhere
    text = html.read_text()
    for title in ("Codes", "Vehicles that stand out", "not judged, and why"):
        assert title in text
    assert text.count('<figure class="plots">') == 2
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    assert "prefers-color-scheme: dark" in text
    said = re.sub(r"<script.*?</script>|sha256-[^']*", "", text, flags=re.DOTALL)
    assert "nan" not in said
    assert "e+0" not in said  # a share of all, or a code in a short time


def test_a_code_is_counted_once_for_a_drive_under_all_its_names() -> None:
    names = [("P2195", "biased_lean", 3), ("P0133", "slow_symmetric", 2), ("P0133", "transient", 2)]
    codes = [{"code": code, "fault": fault} for code, fault, _ in names]
    drives = [{"vehicle": fault, "codes": [code]} for code, fault, n in names for _ in range(n)]
    counts = {"vehicles": 9, "judged": 9, "errors": 0, "with_code": {"events": 7}}
    said = fleet_page._verdict({"codes": codes, "drives_with_code": drives, **counts})
    assert said.endswith("most often P0133 (slow symmetric or transient), in 4 recordings.")


def test_the_command_of_a_drive_s_page_judges_it_as_the_fleet(tmp_path: Path) -> None:
    # GIVEN a fleet of a table and a log with a model and a database of its own
    log = ROOT / "replay_logs" / "delay_symmetric_micro_trips_v108_s112.blf"
    pair = [arg for kind in ("dbc", "toml") for arg in (f"--{kind}", dbc.path(f"o2_ecu.{kind}"))]
    options = ["--model", shipped_model(), *pair[:2], "--map", pair[3], "--channel", "1"]
    out = ["--out", tmp_path / "f.parquet", "--jobs", "1"]
    assert o2train(["fleet", str(log), *map(str, [*options, *out])]) == 0
    # THEN its page has a command that can be pasted
    [(path, *drive)] = re.findall(
        r"o2mon replay (\S+) (.*?)</td>", (tmp_path / "f.html").read_text().replace("<wbr>", "")
    )
    assert path == str(log)
    assert drive == [" ".join(map(str, [*options, "--html", f"{log.stem}.html"]))]


def test_a_fleet_of_which_nothing_could_be_judged_is_reported(tmp_path: Path) -> None:
    (tmp_path / "empty.log").touch()
    kit, out = WorkerKit.of(shipped_model(), config.load()), tmp_path / "out.parquet"
    run = fleet.run(drives_of([str(tmp_path / "empty.log")]), kit, out, lambda _: None)
    html, *_ = fleet_page.write(out, kit, run, str)
    assert "the log is empty" in html.read_text()
