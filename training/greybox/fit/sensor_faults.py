"""Faults of the sensor as rivals of the effects: lag, dead time, gain and offset of the reading.

They act on the reading, after the chain. The definitions are those of the monitor's fault names;
rising phi is lean to rich.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.effects.effect import Parameter
from training.greybox.quantity.dynamics import delayed, followed

Read = Callable[[FloatArray, FloatArray, float], FloatArray]  # phi, parameters, period in s
LAMBDA_MAX, LAMBDA_MIN = 16.0, 0.5


@dataclass(frozen=True, slots=True)
class FaultHypothesis:
    """A gradual fault of the sensor."""

    name: str
    says: str  # the sensor is ...
    parameters: tuple[Parameter, ...]
    read: Read  # healthy phi (n,), parameters (k,), period in s → phi as read


def _slow(
    phi: FloatArray, p: FloatArray, period_s: float, rising: float = 1.0, falling: float = 1.0
) -> FloatArray:
    """Lag the reading; ``rising`` and ``falling`` are 0 for a direction that is as fast as ever."""
    up, down = 1.0 - np.exp(-period_s / np.maximum([rising * p[0], falling * p[0]], 1e-4))
    return followed(phi, (up, up), (down, down))


def _late(phi: FloatArray, p: FloatArray, period_s: float, of: Any = None) -> FloatArray:
    """Delay the reading; in one direction only with ``of`` np.minimum (rising) or np.maximum."""
    late = delayed(phi, p[0] / period_s)
    return np.asarray(late if of is None else of(phi, late))


def _gain(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return np.maximum(1.0 + p[0] * (phi - 1.0), 0.0)


def _offset(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    reading = 1.0 / np.maximum(phi, 1.0 / LAMBDA_MAX) + p[0]
    return 1.0 / np.clip(reading, LAMBDA_MIN, LAMBDA_MAX)


def _transient(phi: FloatArray, p: FloatArray, period_s: float) -> FloatArray:
    return _gain(_slow(phi, p, period_s), p[1:], period_s)


_TIME = Parameter("time", "s", 0.0, 4.0, (0.1, 0.6))
_SENSITIVITY = Parameter("gain", "-", 0.1, 2.0, (0.9,))
_SHIFT = Parameter("offset", "lambda", -0.3, 0.3, (0.01, -0.01))
_L2R, _R2L = "from lean to rich", "from rich to lean"
FAULTS = (
    FaultHypothesis("slow_lean_to_rich", f"slow {_L2R}", (_TIME,), partial(_slow, falling=0.0)),
    FaultHypothesis("slow_rich_to_lean", f"slow {_R2L}", (_TIME,), partial(_slow, rising=0.0)),
    FaultHypothesis("slow_symmetric", "slow", (_TIME,), _slow),
    FaultHypothesis("delay_lean_to_rich", f"late {_L2R}", (_TIME,), partial(_late, of=np.minimum)),
    FaultHypothesis("delay_rich_to_lean", f"late {_R2L}", (_TIME,), partial(_late, of=np.maximum)),
    FaultHypothesis("delay_symmetric", "late", (_TIME,), _late),
    FaultHypothesis("gain_low", "of another sensitivity", (_SENSITIVITY,), _gain),
    FaultHypothesis("biased", "offset", (_SHIFT,), _offset),
    FaultHypothesis(
        "transient", "slow and of another sensitivity", (_TIME, _SENSITIVITY), _transient
    ),
)
