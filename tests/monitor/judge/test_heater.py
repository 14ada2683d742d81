"""The upstream sensor's heater, told by its duty."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.electrical.plausibility import DUTY, Plausibility

CONFIG = config.load().plausibility
PERIOD_S = 0.1
NAMES = ("lambda_measured", "sensor_ready", "engine_speed_rpm", DUTY)


def drive(*stretches: tuple[float, float, float]) -> FloatArray:
    """Return samples with a running engine: (length in s, sensor_ready, duty) one after another."""
    rows = [[1.0, ready, 2000.0, duty] for _, ready, duty in stretches]
    return np.repeat(np.array(rows), [round(s / PERIOD_S) for s, *_ in stretches], axis=0)


def failures(values: FloatArray, block: int | None = None) -> dict[str, int]:
    """Return the first sample at which each fault of the test of readiness shows."""
    tests, block = Plausibility(CONFIG, NAMES, NAMES[0], PERIOD_S), block or len(values)
    found: dict[str, int] = {}
    for first in range(0, len(values), block):
        part = values[first : first + block]
        for begin, _, result in tests.push(part, np.zeros(part.shape, dtype=np.uint8)):
            if result.test == "ready" and result.failed:
                found.setdefault(result.fault, first + begin)
    return found


def test_a_sensor_that_stays_cold_at_full_duty_is_not_heated() -> None:
    assert failures(drive((90.0, 0.0, 100.0))) == {"heater": 600}


def test_a_sensor_that_is_not_ready_with_a_heater_at_its_aim_has_another_fault() -> None:
    assert failures(drive((10.0, 0.0, 100.0), (90.0, 0.0, 45.0))) == {"not_ready": 600}


def test_a_heater_that_needs_full_duty_again_for_long_has_failed_in_hot_exhaust() -> None:
    healthy = (20.0, 1.0, 100.0), (60.0, 1.0, 40.0)
    assert failures(drive(*healthy, (119.0, 1.0, 100.0))) == {}
    assert failures(drive(*healthy, (130.0, 1.0, 100.0))) == {"heater": 2000}


@pytest.mark.parametrize("duty", [0.0, np.nan, 100.0])
def test_a_duty_that_was_never_regulated_tells_nothing_of_a_sensor_that_is_ready(
    duty: float,
) -> None:
    assert failures(drive((400.0, 1.0, duty))) == {}


@given(st.integers(1, 700))
def test_a_heater_is_judged_alike_wherever_blocks_begin(block: int) -> None:
    values = drive((20.0, 0.0, 100.0), (60.0, 1.0, 40.0), (130.0, 1.0, 100.0), (130.0, 0.0, 45.0))
    assert failures(values, block) == failures(values) == {"heater": 2000, "not_ready": 2700}
