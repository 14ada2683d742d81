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


EARLY, LATE = 20.0, 300.0
OFFSETS: dict[str, tuple[Trace, tuple[str, float] | None, float | None]] = {
    "one that a healthy vehicle may have": (drive(-0.03), None, -0.03),
    "one that no healthy vehicle has": (drive(0.1), None, None),
    "one before another comes": (drive(0.02, later=0.2), None, 0.02),
    "one behind a code": (drive(0.03), ("gain_low", EARLY), None),
} | {
    f"one under a code of {fault}": (drive(0.04), (fault, LATE), None)
    for fault in ("biased_lean", "drift_rich", "stuck_lean", "no_activity")
}


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_vehicles_offset_is_one_no_code_tells_of_and_a_healthy_one_may_have(offset: str) -> None:
    trace, code, wanted = OFFSETS[offset]
    recording: dict[str, Any] = {
        "dtcs": [{"fault": code[0], "t_s": code[1]}] if code else [],
        "limits": {"offset_low": -0.065, "offset_high": 0.065},
        "period_s": 0.1,
    }
    assert vehicle_offset(recording, trace) == (wanted if wanted is None else pytest.approx(wanted))


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
