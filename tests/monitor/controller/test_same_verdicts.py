"""The C monitor says of every replay log and of random samples what the Python monitor says."""

import shutil
from pathlib import Path

import pytest

from monitor.base import config
from monitor.base.files import manifest
from monitor.controller.export import export
from monitor.pipeline.recordings import RecordingReader
from monitor.pipeline.replay import Setup, set_up
from tests.conftest import ROOT
from tests.helpers.models import c_monitor

NAMES = sorted(manifest.load(ROOT / "replay_logs"))
pytestmark = pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")


@pytest.fixture(scope="module")
def setup() -> Setup:
    return set_up(None, [], config.load())


@pytest.fixture(scope="module")
def exported(setup: Setup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("c")
    export(setup.model, setup.config, folder)
    return folder


@pytest.fixture(scope="module")
def driver(exported: Path) -> Path:
    return c_monitor.compiled(exported, exported / "driver")


@pytest.mark.parametrize("name", NAMES)
def test_every_window_and_code_of_a_replay_log_is_the_same_in_c(
    name: str, setup: Setup, driver: Path
) -> None:
    drive = RecordingReader(setup.bus_map, setup.model.card).read(ROOT / "replay_logs" / name)
    (python,) = c_monitor.in_python([drive.block], drive.names, setup)
    given = c_monitor.rows(drive.block, drive.names, c_monitor.source_of(setup))
    (c,) = c_monitor.in_c([driver, "-0.065", "0.065", "1", "0"], [given])
    assert c_monitor.differences(python, c) == []
