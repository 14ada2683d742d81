"""The page draws the prediction with this vehicle's own offset, and learns no fault away."""

from typing import Any

import numpy as np
import pytest

from monitor.pipeline.collector import Trace
from monitor.pipeline.entry import fault_words
from monitor.report.vehicle_offset import VehicleOffset, vehicle_offset


def drive(offset: float, later: float | None = None) -> Trace:
    t_s = np.arange(4000) / 10.0
    predicted = 1.0 + 0.03 * np.sin(t_s / 3.0)
    measured = predicted + offset
    if later is not None:
        measured[2000:] += later
    on = np.ones(len(t_s), dtype=np.bool_)
    return Trace(t_s, measured, predicted, on, ~on)


def recording(*dtcs: dict[str, Any]) -> dict[str, Any]:
    limits = {"offset_low": -0.065, "offset_high": 0.065}
    return {"dtcs": list(dtcs), "limits": limits, "period_s": 0.1}


def test_an_offset_that_a_healthy_vehicle_may_have_is_this_vehicles_own() -> None:
    assert vehicle_offset(recording(), drive(-0.03)) == pytest.approx(-0.03)


def test_an_offset_that_no_healthy_vehicle_has_is_not_taken_away() -> None:
    assert vehicle_offset(recording(), drive(0.1)) is None


@pytest.mark.parametrize("fault", ["biased_lean", "drift_rich", "stuck_lean", "no_activity"])
def test_an_offset_under_a_code_that_tells_of_one_is_not_taken_away(fault: str) -> None:
    assert vehicle_offset(recording({"fault": fault, "t_s": 300.0}), drive(0.04)) is None


def test_what_comes_later_in_the_drive_does_not_change_this_vehicles_offset() -> None:
    assert vehicle_offset(recording(), drive(0.02, later=0.2)) == pytest.approx(0.02)


def test_what_comes_after_a_code_is_not_looked_at() -> None:
    assert vehicle_offset(recording({"fault": "gain_low", "t_s": 20.0}), drive(0.03)) is None


def test_sample_by_sample_the_offset_comes_once_there_is_enough_and_then_stays() -> None:
    own = VehicleOffset(-0.065, 0.065, 0.1)
    seen = []
    for k in range(4000):
        own.push(np.array([0.02 if k < 1800 else 0.2]))
        seen.append(own.value(()))
    assert seen[298] is None
    assert seen[299] == seen[-1] == pytest.approx(0.02)
    assert own.value(["stuck_lean"]) is None


def test_of_two_names_the_likelier_stands_first_with_its_probability() -> None:
    code = {"fault": "transient", "also": ["slow_symmetric"], "probability": 0.2}
    assert fault_words(code) == "slow_symmetric (80 %) or transient"
    assert fault_words(code | {"probability": 0.7}) == "transient (70 %) or slow_symmetric"
    assert fault_words({"fault": "gain_low", "probability": 1.0}) == "gain_low"
    assert fault_words(code | {"probability": 1.0}) == "transient (99 %) or slow_symmetric"
