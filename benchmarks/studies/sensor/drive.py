"""Simulation of a trial: the samples that the monitor would see."""

import math

import numba
import numpy as np

from benchmarks.studies.sensor.plan import Trial
from monitor.base import faults
from monitor.base.errors import UsageError
from monitor.base.faults import Fault
from monitor.base.types import FloatArray, SampleBlock
from monitor.decode.bus_map import BusMap
from training.dyno import ecu
from training.dyno.cycles import STEP_S
from training.dyno.effects import Effects
from training.dyno.mixture import LAMBDA_MAX
from training.dyno.simulation import Experiment, simulate

MISSING_FROM_S = 60.0  # until then the message comes

_lag_step = numba.njit(cache=True)(faults.lag_step)
_aged = numba.njit(cache=True)(faults.aged)
_one_sided = numba.njit(cache=True)(faults.one_sided)


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
        signals["lambda_measured"] = put_on(signals["lambda_measured"], fault)
    rng = np.random.default_rng([0x0_2, 5, trial.seed, trial.vehicle])
    return ecu.samples(ecu.broadcast(signals, bus_map, rng, inside, start_s), bus_map, period_ns)


def put_on(lambda_healthy: FloatArray, fault: Fault) -> FloatArray:
    """Return the lambda readings (n,) of a faulty sensor, clipped like the plant's ECU does.

    The result equals that of ``fault_streams.SensorFault``; this form is compiled.
    lambda_healthy : (n,) healthy readings at 100 Hz, NaN where not available
    Raises UsageError for ``not_ready`` and a missing signal: they are no readings.
    """
    if fault.not_ready or fault.missing:
        raise UsageError(f"fault {fault.name}: cannot be put on a reading")
    read = _put_on(
        lambda_healthy,
        tau_rising_s=fault.tau_rising_s,
        tau_falling_s=fault.tau_falling_s,
        delay_steps=round(fault.delay_s / STEP_S),
        direction=fault.delay_direction,
        gain=fault.gain,
        offset_lambda=fault.offset_lambda,
        stuck_lambda=fault.stuck_lambda,
        ripple_lambda=fault.ripple_lambda,
        drift_lambda=fault.drift_lambda,
        hold_s=fault.hold_s,
    )
    return np.asarray(np.minimum(read, LAMBDA_MAX))


@numba.njit(cache=True)
def _put_on(
    healthy: FloatArray,
    tau_rising_s: float,
    tau_falling_s: float,
    delay_steps: int,
    direction: int,
    gain: float,
    offset_lambda: float,
    stuck_lambda: float,
    ripple_lambda: float,
    drift_lambda: float,
    hold_s: float,
) -> FloatArray:
    out = np.full(len(healthy), np.nan)
    seen = np.empty(len(healthy))  # phi of the available readings, oldest first
    n_seen, x, last = 0, math.nan, math.nan
    for k in range(len(healthy)):
        if not math.isfinite(healthy[k]):
            continue
        phi = 1.0 / healthy[k]
        seen[n_seen] = phi
        phi = _one_sided(phi, seen[max(n_seen - delay_steps, 0)], direction)
        x = phi if n_seen == 0 else _lag_step(x, phi, tau_rising_s, tau_falling_s, STEP_S)
        n_seen += 1
        read = 1.0 / max(1.0 + gain * (x - 1.0), 1.0 / 16.0) + offset_lambda
        if stuck_lambda > 0.0:
            read = stuck_lambda
        last = _aged(read, last, (n_seen - 1) * STEP_S, ripple_lambda, drift_lambda, hold_s)
        out[k] = last
    return out
