"""Lags and delays at the sample period: of arrays (n,), or as nodes with a state.

Lags are exact for inputs that run straight between samples (ramp invariance; Franklin, Powell,
Workman, Digital Control of Dynamic Systems, section 6.3): a time constant means the same at any
sample period. ``lag`` alone takes its input as steady between samples.
"""
# mypy: disable-error-code="no-untyped-def"

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numba import njit
from numba.extending import register_jitable

from monitor.base.types import FloatArray
from monitor.model.step import PHI_MAX
from training.greybox.quantity.dual import Dual, moved, value_of
from training.greybox.quantity.value import READING, Quantity, Value, clip, exp, maximum, where

LEAST_S: Final = 1e-6  # time constant of ``lag``
LEAST_SAMPLES: Final = 1e-4  # time constant of ``ramp_lag`` and of a sensor in samples
NEAR: Final = 1e-4  # samples: half of a difference over a delay
LEAST_PROPORTIONAL: Final = 1e-9  # of ``proportional_lag``
LIMITS: Final = (0.0, PHI_MAX)  # of what a sensor reads
Weights = tuple[Quantity, Quantity]  # of a lag: 1 minus that of the state, that of the newest input


@register_jitable
def _ramp_step(x, last, u, drop, newest):
    """Return the next state of a lag of ``u``, for a tensor of a graph or a number."""
    return (x + newest * (u - last)) + drop * (last - x)


def lag(u: Quantity, time_s: Quantity, period_s: float) -> Quantity:
    """Return ``u`` behind a first-order lag that starts settled; ``time_s`` is its time constant.

    >>> lag(np.array([0.0, 1.0, 1.0]), 1.0 / np.log(2.0), 1.0).tolist()
    [0.0, 0.5, 0.75]
    """
    share = 1.0 - exp(-period_s / maximum(time_s, LEAST_S))
    if not isinstance(u, Value):
        return followed(u, (share, share))
    place = u.trace.place()
    x = u.trace.old(place, u)
    return u.trace.keep(place, x + share * (u - x))


def ramp_lag(u: Quantity, time_s: Quantity, period_s: float) -> Quantity:
    """Return ``u`` behind a lag whose time constant may be far below the sample period."""
    drop, newest = _weights(time_s, period_s)
    if isinstance(u, Value):
        x, last, keep = _remembered(u)
        return keep(_ramp_step(x, last, u, drop, newest))
    late = followed(value_of(u), (drop, newest))
    return _with_slopes(late, u, drop, newest)


def _with_slopes(late: FloatArray, u: Quantity, drop: Quantity, newest: Quantity) -> Quantity:
    """Return what a lag made of ``u``, with its derivatives if there are any to have."""
    if not any(isinstance(each, Dual) for each in (u, drop, newest)):
        return late
    last, weights = delayed(value_of(u), 1.0), (_row(value_of(drop)), _row(value_of(newest)))
    moves = moved(late, (drop, last - delayed(late, 1.0)), (newest, value_of(u) - last))
    slopes = {}
    for group in {**moves.slopes, **(u.slopes if isinstance(u, Dual) else {})}:
        none = group.spread(0.0, 1)
        source = moves.spread(group) if group in moves.slopes else none
        own = u.spread(group) if isinstance(u, Dual) and group in u.slopes else none
        slopes[group] = _carried(own, *weights, source, len(late))
    return Dual(late, slopes)


@njit(cache=True)
def _carried(u, drop, newest, source, n):  # pragma: no cover
    """Return derivatives (n, k) behind a lag: of its input, and ``source`` over its weights.

    u, source : (n, k), or (1, k) of zeros
    """
    step, has_own, has_source = len(drop) > 1, len(u) > 1, len(source) > 1
    out = np.empty((n, u.shape[1]))
    out[0] = u[0]
    for k in range(1, n):
        d, w = drop[k * step], newest[k * step]
        for j in range(u.shape[1]):
            x, last = out[k - 1, j], u[(k - 1) * has_own, j]
            out[k, j] = _ramp_step(x, last, u[k * has_own, j], d, w) + source[k * has_source, j]
    return out


def followed(
    u: FloatArray,
    rising: Weights,
    falling: Weights | None = None,
    limits: tuple[float, float] = (-np.inf, np.inf),
) -> FloatArray:
    """Return ``u`` behind a lag with these weights by direction, within limits."""
    falling = falling or rising
    up, down = ((_row(value_of(a)), _row(value_of(b))) for a, b in (rising, falling))
    return _followed(u, up, down, falling is not rising, *limits)


@njit(cache=True)
def _followed(u, rising, falling, by_direction, low, high):  # pragma: no cover
    out = np.empty_like(u)
    x = last = u[0]
    up, down = len(rising[0]) > 1, len(falling[0]) > 1
    for k in range(len(u)):
        if by_direction and u[k] <= x:  # the second is slow to predict, the first is not
            drop, newest = falling[0][k * down], falling[1][k * down]
        else:
            drop, newest = rising[0][k * up], rising[1][k * up]
        x = _ramp_step(x, last, u[k], drop, newest)
        if x < low:  # branches are faster than min and max
            x = low
        elif x > high:
            x = high
        last = u[k]
        out[k] = x
    return out


def proportional_lag(u: Quantity, time_s: Quantity, period_s: float) -> Quantity:
    """Return a positive ``u`` whose logarithm is behind a ramp's lag, which may be none at all.

    A graph takes powers instead, see ``value``.
    """
    drop, newest = _weights(time_s, period_s, LEAST_PROPORTIONAL)
    if not isinstance(u, Value):
        return np.exp(followed(np.log(u), (drop, newest)))
    x, last, keep = _remembered(u)
    return keep(x * (last / x) ** drop * (u / last) ** newest)


def _remembered(
    u: Value, place: int | None = None
) -> tuple[Value, Value, Callable[[Value], Value]]:
    """Return a lag's state and last input, and what keeps its next state, by default a new one."""
    trace = u.trace
    before = trace.place()
    at = trace.place() if place is None else place
    trace.keep(before, u)
    return trace.old(at, u), trace.old(before, u), partial(trace.keep, at)


def sensor_lag(u: Quantity, rising_s: Quantity, falling_s: Quantity, period_s: float) -> Quantity:
    """Return the phi that a sensor reads of ``u``, within 0 .. 1.7, by direction.

    Derivatives are those of a sensor without limits that is as fast in both directions.
    """
    rising = _weights(rising_s, period_s)
    falling = rising if falling_s is rising_s else _weights(falling_s, period_s)
    if isinstance(u, Value):
        x, last, keep = _remembered(u, READING)
        by_direction = (where(u > x, *pair) for pair in zip(rising, falling, strict=True))
        weights = rising if falling is rising else by_direction
        return keep(clip(_ramp_step(x, last, u, *weights), *LIMITS))
    return _with_slopes(followed(value_of(u), rising, falling, LIMITS), u, *rising)


def delayed(u: Quantity, samples: Quantity, *, smooth: bool = False) -> Quantity:
    """Return ``u`` of so many samples ago, the first one before it.

    smooth : by a cubic between samples (Catmull and Rom, 1974), whose slope does not jump, instead
        of straight; not in a graph, whose register holds past samples. There a longer delay is that
        of the register.
    """
    if isinstance(u, Value):
        return _registered(u, samples)
    at = _row(value_of(samples))
    late = _delayed(value_of(u)[:, None], at, smooth)
    if not (isinstance(u, Dual) or isinstance(samples, Dual)):
        return late[:, 0]
    around = (_delayed(value_of(u)[:, None], at + by, smooth) for by in (NEAR, -NEAR))
    partial_slope = np.subtract(*around)[:, 0] / (2.0 * NEAR)
    own = {g: _delayed(u.spread(g), at, smooth) for g in u.slopes} if isinstance(u, Dual) else {}
    return Dual(late[:, 0], own) + moved(0.0, (samples, partial_slope))


def _registered(u: Value, samples: Quantity) -> Value:
    trace, register = u.trace, u.trace.register
    place = trace.place(register)
    history = u.node("Concat", u, trace.old(place, u, register), axis=1)
    trace.keep(place, trace.take(history.name, 0, register))
    away = np.arange(register + 1.0)[None] - clip(samples, 0.0, float(register))
    return (history * maximum(1.0 - abs(away), 0.0)).total()


@njit(cache=True)
def _delayed(u, samples, smooth):  # pragma: no cover
    """Return the rows of ``u`` (n, m) so many samples ago."""
    out, step = np.empty_like(u), len(samples) > 1
    for k in range(len(u)):
        at = max(k - max(samples[k * step], 0.0), 0.0)
        i = int(at)
        s, after = at - i, min(i + 1, k)
        bend = s * (1.0 - s) / 2.0 if smooth else 0.0
        first, last = max(i - 1, 0), min(i + 2, k)
        for j in range(u.shape[1]):
            rise = u[after, j] - u[i, j]
            out[k, j] = u[i, j] + s * rise
            if smooth:
                before, behind = u[i, j] - u[first, j], u[last, j] - u[after, j]
                out[k, j] += bend * ((1.0 - s) * (before - rise) + s * (rise - behind))
    return out


def _weights(time_s: Quantity, period_s: float, least: float = LEAST_SAMPLES) -> Weights:
    time = maximum(time_s / period_s, least)
    drop = 1.0 - exp(-1.0 / time)
    return drop, 1.0 - time * drop


def _row(x: FloatArray | float) -> FloatArray:
    """Return an array (n,) as it is, a number as (1,), for a loop that reads both alike."""
    return x if isinstance(x, np.ndarray) and x.ndim else np.array([x], dtype=np.float64)
