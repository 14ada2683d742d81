"""Simulated drives for tests of the gap workflow: the plant's own effects, as sent and as files."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.faults import resolve
from tests.helpers.drives.simulated_drives import sampled
from tests.helpers.shared import shared
from training import cli
from training.dyno.effects import from_severities
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.greybox.chain import Constants
from training.greybox.fit import drive
from training.greybox.fit.drive import ChainDrive
from training.healthy import yardstick
from training.healthy.behaviour import Healthy

VEHICLE = 2001


CYCLES = ("micro_trips", "udds", "wltc_3b", "us06")
Strength = tuple[str, float] | None  # an effect or a fault, and its severity


def experiment(
    seed: int, cycle: str, effects: Sequence[Strength], fault: Strength, **more: Any
) -> Experiment:
    """Return a drive of the vehicle with effects and perhaps a fault."""
    made = from_severities(dict(each for each in effects if each))
    faulty = resolve(*fault) if fault else None
    return Experiment(cycle, VEHICLE, seed, faulty, effects=made, **more)


@cache
def simulated(
    cycle: str,
    seed: int,
    effect: Strength = None,
    fault: Strength = None,
    fault_start_s: float = 0.0,
    also: Strength = None,
) -> ChainDrive:
    """Return ten minutes of a drive as the monitor's grid sees them."""
    times = {"fault_start_s": fault_start_s, "duration_s": 600.0}
    made = experiment(seed, cycle, (effect, also), fault, **times)
    block, names = sampled(made, np.random.default_rng([5, seed]))
    columns = dict(zip(names, block.values.T, strict=True))
    measured = columns.pop("lambda_measured")
    return drive.make(made.name, 0.1, columns, measured)


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


def drives(
    folder: Path,
    seed: int,
    effect: Strength = None,
    fault: Strength = None,
    suffixes: Sequence[str] = ("parquet", "parquet", "parquet"),
) -> list[Path]:
    """Write drives of 400 s with the same effect or fault in each; return their paths."""
    return [
        write(experiment(seed + i, cycle, (effect,), fault, duration_s=400.0), folder, suffix)
        for i, (cycle, suffix) in enumerate(zip(CYCLES, suffixes, strict=False))
    ]


def run(*arguments: str | Path) -> int:
    """Run ``o2train gap``; return the exit code."""
    return cli.main(["gap", *map(str, arguments)])
