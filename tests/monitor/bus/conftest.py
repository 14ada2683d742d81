"""The usual setup and the log of a late sensor, for tests of the live loop."""

import pytest

from monitor.base.types import Frame
from monitor.frames.logs import read_frames
from tests.conftest import ROOT


@pytest.fixture(scope="session")
def late_sensor() -> list[Frame]:
    (log,) = ROOT.glob("replay_logs/delay_rich_to_lean_*.blf")
    return list(read_frames(log))[: 200 * 70]
