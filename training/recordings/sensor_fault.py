"""A sensor fault put on the readings of a whole recording, behind the control loop."""

import numba
import numpy as np
from numpy.typing import ArrayLike

from monitor.base import faults
from monitor.base.faults import Fault
from monitor.base.types import FloatArray

_lag_step = numba.njit(cache=True)(faults.lag_step)
_aged = numba.njit(cache=True)(faults.aged)
_one_sided = numba.njit(cache=True)(faults.one_sided)


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
    return np.asarray(
        _readings(
            healthy,
            period_s,
            round(fault.delay_s / period_s),
            fault.delay_direction,
            fault.tau_rising_s,
            fault.tau_falling_s,
            fault.gain,
            fault.offset_lambda,
            fault.stuck_lambda,
            fault.ripple_lambda,
            fault.drift_lambda,
            fault.hold_s,
        )
    )


@numba.njit(cache=True)
def _readings(
    healthy: FloatArray,
    period_s: float,
    late: int,  # samples of dead time
    direction: int,
    tau_rising_s: float,
    tau_falling_s: float,
    gain: float,
    offset: float,
    stuck: float,
    ripple: float,
    drift: float,
    hold_s: float,
) -> FloatArray:
    read, phis = np.empty(len(healthy)), np.empty(len(healthy))
    x, last, valid = np.nan, np.nan, 0
    for k in range(len(healthy)):
        reading = healthy[k]
        is_valid = np.isfinite(reading) and reading > 0.0
        if not np.isfinite(reading):
            reading = np.nan
        elif stuck > 0.0:
            reading = stuck
        elif is_valid:
            phis[valid] = 1.0 / reading
            phi = _one_sided(phis[valid], phis[max(valid - late, 0)], direction)
            x = _lag_step(phi if np.isnan(x) else x, phi, tau_rising_s, tau_falling_s, period_s)
            reading = 1.0 / max(1.0 + gain * (x - 1.0), 1.0 / 16.0) + offset
        valid += is_valid
        if np.isfinite(reading) and reading > 0.0:
            last = _aged(reading, last, (valid - 1) * period_s, ripple, drift, hold_s)
            reading = last
        read[k] = reading
    return read
