"""The usual setup and the log of a late sensor, for tests of the live loop."""

import pytest

from monitor.base.types import Frame
from tests.helpers.logs.replays import frames_of


@pytest.fixture(scope="session")
def late_sensor() -> list[Frame]:
    return frames_of("delay_rich_to_lean", 50.0)
