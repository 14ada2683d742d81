"""What all tests share: one thread per numeric library, property test profile, shared data."""

import gc
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

from tests.helpers import shared
from tests.helpers.examples import USUAL, number

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from monitor.pipeline.replay import Setup

gc.disable()  # until all tests are imported: what they import stays

# Before any test imports numpy: one thread is the fastest on small matrices.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_threads] = "1"

ROOT = Path(__file__).resolve().parent.parent

# Under nohup the programs that tests start would inherit an ignored hang-up.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

settings.register_profile("default", deadline=None, max_examples=number(USUAL))
# A case that is found elsewhere is printed, and becomes an @example of its test.
settings.register_profile("ci", settings.get_profile("default"), derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


# Fixtures and folders whose tests `make check` leaves out: mark -> names of either.
MARKS = {
    "kernel": ("run_with_vcan",),
    "browser": ("browser",),
    "trains": (
        "benchmarks",
        "test_benchmarks.py",
        "training/api",
        "training/fleet",
        "training/gap",
        "training/greybox",
        "training/healthy",
        "training/limits",
        "training/narx",
        "training/study",
        "monitor/cli/test_log_doctor.py",
        "monitor/pipeline/test_acceptance.py",
        "monitor/pipeline/test_vehicles.py",
    ),
    "thorough": (
        "monitor/controller/test_misra.py",
        "monitor/controller/test_on_the_core.py",
        "monitor/controller/test_same_verdicts.py",
        "monitor/decode/test_block_decoder.py",
        "monitor/frames/test_blf_blocks.py",
        "monitor/mapping",
        "monitor/pipeline",
        "monitor/report/test_replay_logs.py",
    ),
    "waits": (
        "monitor/bus",
        "monitor/inject/test_gateway.py",
        "monitor/memory/test_disk.py",
        "monitor/sinks/test_broker.py",
        "test_packaging.py",
    ),
}

FIRST = ("kernel", "trains", "waits", "browser", "thorough")  # marks in the order of a run


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave the files unread of which ``make check`` deselects all tests, see ``MARKS``."""
    place = collection_path.relative_to(ROOT / "tests").as_posix()
    deselected = [mark for mark in MARKS if f"not {mark}" in _terms(config)]
    return True if any(place in MARKS[mark] for mark in deselected) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow tests, and sort them by their marks in the order of ``FIRST``."""
    for item in items:
        place = item.path.relative_to(ROOT / "tests").as_posix()
        fixtures = getattr(item, "fixturenames", ())
        for mark, names in MARKS.items():
            if any(place.startswith(name) or name in fixtures for name in names):
                item.add_marker(mark)
    items.sort(key=_rank)


def pytest_collection_finish() -> None:
    """Let no collection of garbage walk what the tests have imported."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


class OneWorkerPerFile(LoadScopeScheduling):
    """One worker runs the tests of a file, so that a fixture of a module is made once.

    Tests with a kernel share a lock: one worker runs all of them.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.split("::", 1)[0]
        return "kernel" if file.startswith("tests/vcan/") else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> OneWorkerPerFile | None:
    """Share the tests out by files where the command line asks for ``--dist loadscope``."""
    return OneWorkerPerFile(config, log) if config.getvalue("dist") == "loadscope" else None


def _terms(config: pytest.Config) -> list[str]:
    """Return the terms of ``-m`` if all of them must hold."""
    expression: str = config.getvalue("markexpr")
    return [] if " or " in expression else expression.split(" and ")


def _rank(item: pytest.Item) -> int:
    """Return the place of a test in a run: the long ones first, so that no worker ends late."""
    marks = {mark.name for mark in item.iter_markers()}
    last = len(FIRST) + ("training" not in item.path.parts)
    return next((rank for rank, mark in enumerate(FIRST) if mark in marks), last)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove what the workers of this run shared."""
    if uid := getattr(config.pluginmanager.get_plugin("dsession"), "nodemanager", None):
        shutil.rmtree(shared.folder(uid.testrunuid), ignore_errors=True)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Give the folder of real recordings beside the repository, or skip."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the shared recordings (../shared/data beside the repository) are not here")
    return folder


@pytest.fixture(scope="module")
def setup() -> "Setup":
    """Give the shipped model, map and settings."""
    from monitor.base import config
    from monitor.pipeline import replay

    return replay.set_up(None, [], config.load())


@pytest.fixture(scope="session")
def minutes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the begin of a healthy drive as a log, long enough for nearly all faults."""
    from tests.helpers.logs.injected_frames import first_minutes

    return first_minutes(tmp_path_factory.mktemp("minutes"))


@pytest.fixture(scope="session")
def ninety_seconds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give less of it, in which the most are found."""
    from tests.helpers.logs.injected_frames import first_minutes

    return first_minutes(tmp_path_factory.mktemp("minutes"), 90.0)


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    """Give a browser that opens pages."""
    from tests.helpers.bus.chromium import chromium

    with chromium() as running:
        yield running
