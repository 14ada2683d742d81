"""Simulated drives for tests of the gap workflow: the plant's own effects, as sent on its bus."""

from functools import cache
from typing import Any

import numpy as np

from monitor.base.faults import resolve
from tests.helpers.drives.simulated_drives import sampled
from tests.helpers.shared import shared
from training.dyno.effects import from_severities
from training.dyno.simulation import Experiment
from training.greybox.chain import Constants
from training.greybox.fit import drive
from training.greybox.fit.drive import ChainDrive
from training.healthy import yardstick
from training.healthy.behaviour import Healthy

VEHICLE = 2001


@cache
def simulated(
    cycle: str,
    seed: int,
    effect: tuple[str, float] | None = None,
    fault: tuple[str, float] | None = None,
    fault_start_s: float = 0.0,
    also: tuple[str, float] | None = None,
) -> ChainDrive:
    """Return ten minutes of a drive as the monitor's grid sees them."""
    experiment = Experiment(
        cycle=cycle,
        vehicle=VEHICLE,
        seed=seed,
        effects=from_severities(dict(each for each in (effect, also) if each)),
        fault=resolve(*fault) if fault else None,
        fault_start_s=fault_start_s,
        duration_s=600.0,
    )
    block, names = sampled(experiment, np.random.default_rng([5, seed]))
    columns = dict(zip(names, block.values.T, strict=True))
    measured = columns.pop("lambda_measured")
    return drive.make(experiment.name, 0.1, columns, measured)


@shared
def known() -> Healthy:
    """Return what these drives say, and how far they contradict each other."""
    return yardstick.learn(healthy(), Constants())


@cache
def healthy() -> tuple[ChainDrive, ...]:
    """Return the vehicle's drives without effect and fault."""
    cycles = ("wltc_3b", "micro_trips", "udds", "us06")
    return tuple(simulated(cycle, 2_020_011 + i) for i, cycle in enumerate(cycles))


def two_drives(seed: int, *effect: tuple[str, float], **other: Any) -> list[ChainDrive]:
    """Return two drives with the same effect or fault in each."""
    cycles = ("micro_trips", "wltc_3b")
    return [simulated(cycle, seed + i, *effect, **other) for i, cycle in enumerate(cycles)]
