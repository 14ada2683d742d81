"""A sensor fault put on the readings of a whole recording, behind the control loop."""

from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike

from monitor.base import faults
from monitor.base.faults import Fault
from monitor.base.signals import OUTPUT
from monitor.base.types import FloatArray
from training.recordings.recording import Recording

_lag_step = numba.njit(cache=True)(faults.lag_step)
_aged = numba.njit(cache=True)(faults.aged)
_one_sided = numba.njit(cache=True)(faults.one_sided)


class SensorParameters(NamedTuple):
    """A sensor fault as plain numbers for the compiled loop, all but the last two its own."""

    tau_rising_s: float
    tau_falling_s: float
    delay_s: float
    delay_direction: int
    gain: float
    offset_lambda: float
    stuck_lambda: float
    ripple_lambda: float
    drift_lambda: float
    hold_s: float
    not_ready: float
    start_s: float

    @classmethod
    def of(cls, fault: Fault, start_s: float) -> "SensorParameters":
        """Return the numbers of a fault that begins at ``start_s``."""
        own = {name: getattr(fault, name) for name in cls._fields[:-2]}
        return cls(**own, not_ready=float(fault.not_ready or fault.missing), start_s=start_s)


def put_on(
    recording: Recording, fault: Fault, output: str = OUTPUT, transform: str = "phi"
) -> Recording:
    """Return the recording as a faulty sensor would have read the same mixture.

    An output that is not lambda falls where phi rises; the gain acts around its median.
    """
    values, column = recording.values.copy(), recording.names.index(output)
    own, period_s = values[:, column], recording.period_ns / 1e9
    if transform == "phi":
        values[:, column] = faulty_readings(fault, own, period_s)
    else:
        middle = float(np.nanmedian(own))
        small = 0.1 / max(float(np.nanmax(np.abs(own - middle))), 1e-9)  # keeps phi near 1
        phi = 1.0 / faulty_readings(fault, 1.0 / (1.0 - small * (own - middle)), period_s)
        values[:, column] = middle + (1.0 - phi) / small
    return replace(recording, values=values)


def faulty_readings(fault: Fault, lambda_healthy: ArrayLike, period_s: float) -> FloatArray:
    """Return the faulty sensor's readings in lambda (n,) of a healthy one's (n,).

    NaN and infinity give NaN, values of 0 and below stay; neither leaves a trace in the readings
    that follow. Communication faults (not_ready, signal_missing) read NaN.

    >>> from monitor.base.faults import resolve
    >>> faulty_readings(resolve("biased_lean", 0.1), [1.0, 0.9], 0.1).round(3).tolist()
    [1.1, 1.0]
    """
    healthy = np.asarray(lambda_healthy, np.float64)
    if fault.not_ready or fault.missing:
        return np.full(len(healthy), np.nan)
    own = SensorParameters.of(fault, 0.0)
    return np.asarray(_readings(healthy, period_s, round(fault.delay_s / period_s), own))


@numba.njit(cache=True)
def _readings(healthy: FloatArray, period_s: float, late: int, f: SensorParameters) -> FloatArray:
    """Return the readings; ``late`` are the samples of dead time."""
    read, phis = np.empty(len(healthy)), np.empty(len(healthy))
    x, last, valid = np.nan, np.nan, 0
    for k in range(len(healthy)):
        reading = healthy[k]
        is_valid = np.isfinite(reading) and reading > 0.0
        if not np.isfinite(reading):
            reading = np.nan
        elif f.stuck_lambda > 0.0:
            reading = f.stuck_lambda
        elif is_valid:
            phis[valid] = 1.0 / reading
            phi = _one_sided(phis[valid], phis[max(valid - late, 0)], f.delay_direction)
            x = phi if np.isnan(x) else x
            x = _lag_step(x, phi, f.tau_rising_s, f.tau_falling_s, period_s)
            reading = 1.0 / max(1.0 + f.gain * (x - 1.0), 1.0 / 16.0) + f.offset_lambda
        valid += is_valid
        if np.isfinite(reading) and reading > 0.0:
            since_s, drift = (valid - 1) * period_s, f.drift_lambda
            last = _aged(reading, last, since_s, f.ripple_lambda, drift, f.hold_s)
            reading = last
        read[k] = reading
    return read
