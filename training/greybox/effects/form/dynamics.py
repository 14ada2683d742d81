"""First-order lags, slope and store of effects as arrays, at the sample period."""
# mypy: disable-error-code="no-untyped-def"

from typing import Final

import numpy as np
from numba import njit

from monitor.base.types import BoolArray, FloatArray

LEAST_S: Final = 1e-6  # time constant of ``lag``
LEAST_SAMPLES: Final = 1e-9  # time constant of ``ramp_lag`` in samples


@njit(cache=True)
def _lag(u, share):
    out = np.empty_like(u)
    x = u[0]
    for k in range(len(u)):
        x += share[k] * (u[k] - x)
        out[k] = x
    return out


def lag(u: FloatArray, time_s: FloatArray | float, period_s: float) -> FloatArray:
    """Return ``u`` (n,) behind a first-order lag that starts settled.

    time_s : time constant in s, a number or (n,)
    """
    share = 1.0 - np.exp(-period_s / np.maximum(time_s, LEAST_S))
    return _lag(u, np.broadcast_to(share, u.shape))


@njit(cache=True)
def _ramp_lag(u, time):
    out = np.empty_like(u)
    x = last = u[0]
    for k in range(len(u)):
        keep = np.exp(-1.0 / time[k])
        newest = 1.0 - time[k] * (1.0 - keep)
        x = keep * x + newest * u[k] + (1.0 - keep - newest) * last
        last = u[k]
        out[k] = x
    return out


def ramp_lag(u: FloatArray, time_s: FloatArray, period_s: float) -> FloatArray:
    """Return ``u`` (n,) behind a lag whose time constant may be far below the sample period.

    Exact for an input that runs straight between samples, like the lags of the chain.
    """
    return _ramp_lag(u, np.maximum(time_s / period_s, LEAST_SAMPLES))


def slope(u: FloatArray, period_s: float) -> FloatArray:
    """Return the time derivative of ``u`` (n,) by central differences, per second."""
    return np.asarray(np.gradient(u) / period_s)


@njit(cache=True)
def _decay(active, share_up, share_down):
    out = np.zeros(len(active))
    x = 0.0
    for k in range(len(active)):
        x = x + share_up * (1.0 - x) if active[k] else x * (1.0 - share_down[k])
        out[k] = x
    return out


def charged(
    active: BoolArray, up_s: float, down_s: FloatArray | float, period_s: float
) -> FloatArray:
    """Return a store (n,) that fills to 1 while ``active`` and empties afterwards.

    up_s, down_s : time constants in s of filling and emptying
    """
    down = 1.0 - np.exp(-period_s / np.maximum(down_s, LEAST_S))
    share_up = 1.0 - np.exp(-period_s / up_s)
    return _decay(active, share_up, np.broadcast_to(down, active.shape))
