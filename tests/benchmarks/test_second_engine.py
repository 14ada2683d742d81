"""Faulty sensors of the second engine act within its control loop."""

from functools import cache

import numpy as np

from benchmarks.studies.second.engine import PERIOD_S, Sensor, broadcast
from monitor.base import faults
from monitor.base.signals import OUTPUT
from monitor.base.types import BoolArray, FloatArray

VEHICLE, SEED, LENGTH_S = 4, 4003, 300.0  # a warm start


@cache
def sent(
    fault: str = "", severity: float | None = None, start_s: float = 0.0
) -> dict[str, FloatArray]:
    sensor = Sensor.of(faults.resolve(fault, severity), start_s) if fault else Sensor()
    return broadcast(VEHICLE, SEED, sensor=sensor, length_s=LENGTH_S)


def closed() -> BoolArray:
    return np.asarray(sent()["closed_loop"] == 1.0)


def after_edges(fault: str, rising: bool) -> float:
    """Return the mean distance in phi from the sound reading within 1 s of a fuel cut's edge."""
    cut, apart = sent()["fuel_cut"] > 0.5, 1.0 / sent(fault, 0.5)[OUTPUT] - 1.0 / sent()[OUTPUT]
    edges = np.flatnonzero(np.diff(cut.astype(int)) == (-1 if rising else 1))
    return float(np.mean([np.abs(apart[k : k + 10]).mean() for k in edges]))


def test_the_controller_takes_back_an_offset_of_the_reading() -> None:
    # GIVEN a sensor that reads 0.05 lean from the start
    # WHEN the loop has settled
    on = closed() & (np.arange(len(closed())) * PERIOD_S > 100.0)
    richer = sent("biased_lean", 0.05)["fuel_mass_mg"][on] / sent()["fuel_mass_mg"][on] - 1.0
    apart = (sent("biased_lean", 0.05)[OUTPUT] - sent()[OUTPUT])[on]
    # THEN the fuel has grown by most of it, and the reading is nearly as before
    assert 0.035 < np.median(richer) < 0.06
    assert abs(np.median(apart)) < 0.015


def test_a_fault_changes_nothing_before_it_begins() -> None:
    late = sent("biased_lean", 0.05, 150.0)
    n = round(150.0 / PERIOD_S)
    for name, values in sent().items():
        assert np.array_equal(late[name][:n], values[:n]), name
    assert (late[OUTPUT][n:] != sent()[OUTPUT][n:]).mean() > 0.5
    assert (late["fuel_mass_mg"][n:] != sent()["fuel_mass_mg"][n:]).mean() > 0.5


def test_a_lag_or_dead_time_of_one_edge_spares_the_other() -> None:
    for kind in ("slow", "delay"):
        to_lean, to_rich = f"{kind}_rich_to_lean", f"{kind}_lean_to_rich"
        assert after_edges(to_lean, rising=False) > 2.0 * after_edges(to_lean, rising=True)
        assert after_edges(to_rich, rising=True) > 2.0 * after_edges(to_rich, rising=False)


def test_a_sensor_that_is_not_ready_opens_the_loop() -> None:
    for fault in ("not_ready", "signal_missing"):
        assert not sent(fault)["closed_loop"].any()
        assert (sent(fault)["lambda_controller"] == 1.0).all()
    assert not sent("not_ready")["sensor_ready"].any()
    assert np.isnan(sent("signal_missing")[OUTPUT]).all()
