"""Faults of the sensor as rivals of the effects: lag, dead time, gain and offset of the reading.

They act on the reading, after the chain. The definitions are those of the monitor's fault names;
rising phi is lean to rich.
"""
# mypy: disable-error-code="no-untyped-def"

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from monitor.base.types import FloatArray
from training.greybox.effects.effect import Parameter
from training.greybox.quantity.dynamics import delayed

Read = Callable[[FloatArray, FloatArray, float], FloatArray]
LAMBDA_MAX, LAMBDA_MIN = 16.0, 0.5


@dataclass(frozen=True, slots=True)
class FaultHypothesis:
    """A gradual fault of the sensor."""

    name: str
    says: str  # the sensor is ...
    parameters: tuple[Parameter, ...]
    read: Read  # healthy phi (n,), parameters (k,), period in s → phi as read


@njit(cache=True)
def _lag(u, keep_rising, keep_falling):  # pragma: no cover
    out = np.empty_like(u)
    x = u[0]
    for k in range(len(u)):
        keep = keep_rising if u[k] > x else keep_falling
        x = u[k] + keep * (x - u[k])
        out[k] = x
    return out


def _slow(phi: FloatArray, rising_s: float, falling_s: float, period_s: float) -> FloatArray:
    keep = np.exp(-period_s / np.maximum([rising_s, falling_s], 1e-4))
    return _lag(phi, keep[0], keep[1])


def _slow_lean_to_rich(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return _slow(phi, p[0], 0.0, period_s)


def _slow_rich_to_lean(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return _slow(phi, 0.0, p[0], period_s)


def _slow_symmetric(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return _slow(phi, p[0], p[0], period_s)


def _delay_lean_to_rich(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return np.minimum(phi, delayed(phi, p[0] / period_s))


def _delay_rich_to_lean(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return np.maximum(phi, delayed(phi, p[0] / period_s))


def _delay_symmetric(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return np.asarray(delayed(phi, p[0] / period_s))


def _gain(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return np.maximum(1.0 + p[0] * (phi - 1.0), 0.0)


def _offset(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    reading = 1.0 / np.maximum(phi, 1.0 / LAMBDA_MAX) + p[0]
    return 1.0 / np.clip(reading, LAMBDA_MIN, LAMBDA_MAX)


def _transient(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return _gain(_slow(phi, p[0], p[0], period_s), p[1:], period_s)


_TIME = Parameter("time", "s", 0.0, 4.0, (0.1, 0.6))
FAULTS = (
    FaultHypothesis("slow_lean_to_rich", "slow from lean to rich", (_TIME,), _slow_lean_to_rich),
    FaultHypothesis("slow_rich_to_lean", "slow from rich to lean", (_TIME,), _slow_rich_to_lean),
    FaultHypothesis("slow_symmetric", "slow", (_TIME,), _slow_symmetric),
    FaultHypothesis("delay_lean_to_rich", "late from lean to rich", (_TIME,), _delay_lean_to_rich),
    FaultHypothesis("delay_rich_to_lean", "late from rich to lean", (_TIME,), _delay_rich_to_lean),
    FaultHypothesis("delay_symmetric", "late", (_TIME,), _delay_symmetric),
    FaultHypothesis(
        "gain_low", "of another sensitivity", (Parameter("gain", "-", 0.1, 2.0, (0.9,)),), _gain
    ),
    FaultHypothesis(
        "biased", "offset", (Parameter("offset", "lambda", -0.3, 0.3, (0.01, -0.01)),), _offset
    ),
    FaultHypothesis(
        "transient",
        "slow and of another sensitivity",
        (_TIME, Parameter("gain", "-", 0.1, 2.0, (0.9,))),
        _transient,
    ),
)
