"""Simulated drives judged by fuel cuts alone: the edges of lambda without any dither."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base import faults
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.simulated_drives import WARM, sampled
from tests.helpers.logs.streamed import SHIPPED
from training.dyno.simulation import Experiment
from training.limits.side_by_side import Judged, RecordingJudge

MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SHIPPED, "shipped")
DRIVE = Experiment("udds", vehicle=3, seed=9300, conditions=WARM, duration_s=700.0)


def judged(fault: str | None, severity: float | None, limits: Limits = LIMITS) -> Judged:
    own = faults.resolve(fault, severity) if fault else None
    block, names = sampled(replace(DRIVE, fault=own), np.random.default_rng(3))
    block.values[:, names.index("closed_loop")] = 0.0  # nothing but fuel cuts may decide
    return RecordingJudge(names, MODEL, limits, SHIPPED).judge([block])[0]


@pytest.mark.parametrize(
    ("fault", "severity"), [("slow_rich_to_lean", 0.6), ("delay_lean_to_rich", 0.5)]
)
def test_fuel_cuts_alone_name_a_slow_or_late_sensor(fault: str, severity: float) -> None:
    got = judged(fault, severity)
    assert [dtc.fault for dtc in got.dtcs if dtc.fault.startswith(("slow", "delay"))] == [fault]
    assert got.windows == []


def test_fuel_cuts_alone_call_a_sound_sensor_sound() -> None:
    got = judged(None, None)
    assert got.dtcs == []
    assert got.completed
    assert len(got.cuts) >= 10


def test_a_sensor_that_does_not_follow_fuel_cuts_is_dead_though_the_model_errs_elsewhere() -> None:
    # GIVEN a model so poor that no movement of the mixture but a fuel cut is beyond its error
    limits = replace(LIMITS, noise=0.05)
    # WHEN the sensor reads a constant and its noise, and fuel is cut
    got = judged("no_activity", 0.003, limits)
    # THEN it is called dead; a weak one is alive
    assert [dtc.fault for dtc in got.dtcs] == ["no_activity"]
    assert "no_activity" not in [dtc.fault for dtc in judged("gain_low", 0.5, limits).dtcs]
