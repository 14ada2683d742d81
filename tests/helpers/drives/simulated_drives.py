"""Drives of the simulated vehicle that several tests look at."""

from collections.abc import Mapping
from functools import cache

import numpy as np

from monitor.base.types import FloatArray, SampleBlock
from training.dyno import ecu, vehicle
from training.dyno.simulation import Experiment, simulate

WARM = vehicle.conditions(1)._replace(coolant_start_degc=85.0)
SHORT = Experiment(duration_s=60.0, conditions=WARM)
FAULT_DRIVE = Experiment(duration_s=300.0, conditions=WARM)


def to_grid(x: FloatArray) -> FloatArray:
    """100 Hz to 10 Hz, averaged over the tick."""
    n = len(x) // 10 * 10
    return np.asarray(x[:n].reshape(-1, 10).mean(axis=1))


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


@cache
def driven(experiment: Experiment) -> Mapping[str, FloatArray]:
    return simulate(experiment)


def differs(a: Mapping[str, FloatArray], b: Mapping[str, FloatArray], name: str) -> bool:
    return not np.array_equal(a[name], b[name], equal_nan=True)


def sampled(
    experiment: Experiment, rng: np.random.Generator | None = None
) -> tuple[SampleBlock, tuple[str, ...]]:
    """Return a drive's samples at 10 Hz, as the monitor makes them of its frames, and their names.

    rng : draws phase and jitter of the messages
    """
    bus = ecu.own_bus()
    rng = rng or np.random.default_rng([experiment.seed, experiment.vehicle])
    sent = ecu.broadcast(simulate(experiment), bus, rng, experiment.fault, experiment.fault_start_s)
    return ecu.samples(sent, bus, 100_000_000), ecu.names_of(sent, bus)
