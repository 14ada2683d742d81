"""Simulation of a trial: the samples that the monitor would see."""

import numpy as np

from benchmarks.studies.sensor.plan import Trial
from monitor.base import faults
from monitor.base.types import SampleBlock
from monitor.decode.bus_map import BusMap
from training.dyno import ecu
from training.dyno.cycles import STEP_S
from training.dyno.effects import Effects
from training.dyno.mixture import LAMBDA_MAX
from training.dyno.simulation import Experiment, simulate
from training.recordings.sensor_fault import faulty_readings

MISSING_FROM_S = 60.0  # until then the message comes


def samples(trial: Trial, bus_map: BusMap, period_ns: int) -> SampleBlock:
    """Return the trial's drive on the sample grid, with columns as in ``bus_map.names``.

    Raises UsageError for an unknown cycle or fault.
    """
    fault = faults.resolve(trial.fault, trial.severity) if trial.fault else None
    inside = fault if trial.placement == "loop" else trial.aged
    # a message that never came is no fault that a first drive can show
    start_s = MISSING_FROM_S if inside is not None and inside.missing else 0.0
    signals = simulate(
        Experiment(
            trial.cycle,
            trial.vehicle,
            trial.seed,
            inside,
            start_s,
            effects=Effects(ethanol=trial.ethanol),
            conditions=trial.conditions,
        )
    )
    if fault is not None and trial.placement == "after":
        read = faulty_readings(fault, signals["lambda_measured"], STEP_S)
        signals["lambda_measured"] = np.minimum(read, LAMBDA_MAX)
    rng = np.random.default_rng([0x0_2, 5, trial.seed, trial.vehicle])
    return ecu.samples(ecu.broadcast(signals, bus_map, rng, inside, start_s), bus_map, period_ns)
