"""Fuel cuts: the edges of lambda that a drive has without any dither tell of the sensor, too."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base import faults
from monitor.base.types import SampleBlock
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.logs.streamed import PERIOD_NS, SHIPPED
from training.dyno import ecu, vehicle
from training.dyno.simulation import Experiment, simulate
from training.limits.side_by_side import Judged, RecordingJudge

WARM = vehicle.conditions(1)._replace(coolant_start_degc=85.0)
DRIVE = Experiment("udds", vehicle=3, seed=9300, conditions=WARM, duration_s=700.0)
MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SHIPPED, "shipped")


def drive(fault: str | None, severity: float | None = None) -> tuple[SampleBlock, tuple[str, ...]]:
    own = faults.resolve(fault, severity) if fault else None
    experiment = replace(DRIVE, fault=own)
    bus_map = ecu.own_bus()
    rng = np.random.default_rng(3)
    sent = ecu.broadcast(simulate(experiment), bus_map, rng, own, 0.0)
    block = ecu.samples(sent, bus_map, PERIOD_NS)
    block.values[:, bus_map.names.index("closed_loop")] = 0.0  # nothing but fuel cuts may decide
    return block, bus_map.names


def judged(fault: str | None, severity: float | None, limits: Limits = LIMITS) -> Judged:
    block, names = drive(fault, severity)
    return RecordingJudge(names, MODEL, limits, SHIPPED).judge([block])[0]


@pytest.mark.parametrize(
    ("fault", "severity"),
    [
        ("slow_rich_to_lean", 0.6),
        ("delay_lean_to_rich", 0.5),
    ],
)
def test_fuel_cuts_alone_name_a_sensor_that_is_slow_or_late_on_one_edge(
    fault: str, severity: float
) -> None:
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
