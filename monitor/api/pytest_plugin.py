"""The plug-in of pytest: the fixture ``o2_scenario``. Nothing else here imports pytest."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from monitor.api.scenarios import ScenarioResult


@pytest.fixture(scope="session")
def o2_scenario() -> "Callable[..., ScenarioResult]":
    """``play_scenario``: put faults into a healthy drive, judge it, return a ``ScenarioResult``."""
    from monitor.api.scenarios import play_scenario  # noqa: PLC0415 - only tests that use it pay

    return play_scenario
