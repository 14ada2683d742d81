"""Columns from which a linear fit predicts any output: filtered inputs and functions of them.

Every input passes a bank of first-order lags and a few dead times; random smooth functions of the
bank bend it. The fit is linear, so leaving a run out costs one solve.
Source: Rahimi and Recht, Random features for large-scale kernel machines, NIPS 2007.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from training.greybox.fit.comparison import Comparison
from training.recordings.samples.rows import hold

LAGS_S: Final = (0.0, 0.2, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0)
DEAD_TIMES_S: Final = (0.2, 0.4, 0.8)
FUNCTIONS: Final = 300  # random ones, each of few of the bank's columns
SHARE, SLOPE, OFFSETS = 0.08, 1.0, 2.0
RANGE: Final = (0.001, 0.999)  # quantiles of the healthy recordings; beyond, an input is clipped
SEED: Final = 0


@dataclass(frozen=True, slots=True)
class Regressors:
    """The columns' scaling, from healthy recordings."""

    inputs: tuple[str, ...]
    low: FloatArray  # (k,)
    high: FloatArray
    mean: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, healthy: Sequence[Comparison], inputs: Sequence[str]) -> "Regressors":
        """Return the columns for a model's inputs."""
        values = np.concatenate([_columns(r, inputs)[r.scored] for r in healthy])
        low, high = np.quantile(values, RANGE, axis=0)
        return cls(
            inputs=tuple(inputs),
            low=low,
            high=high,
            mean=values.mean(axis=0),
            spread=np.maximum(values.std(axis=0), 1e-12),
        )

    def __call__(self, run: Comparison) -> FloatArray:
        """Return the columns (n, m) of one recording; the first is a constant."""
        values = np.clip(_columns(run, self.inputs), self.low, self.high)
        scaled = (values - self.mean) / self.spread
        steps = [max(round(s / run.period_s), 1) for s in DEAD_TIMES_S]
        bank = np.column_stack(
            [
                *(lagged(scaled, s, run.period_s) for s in LAGS_S),
                *(delayed(scaled, k) for k in dict.fromkeys(steps)),
            ]
        )
        rng = np.random.default_rng(SEED)
        shape = (bank.shape[1], FUNCTIONS)
        weights = rng.standard_normal(shape) * (rng.random(shape) < SHARE) * SLOPE
        bent = np.tanh(bank @ weights + rng.uniform(-OFFSETS, OFFSETS, FUNCTIONS))
        return np.column_stack([np.ones(len(bank)), bank, bent])


def lagged(values: FloatArray, lag_s: float, period_s: float) -> FloatArray:
    """Return ``values`` (n,) or (n, k) after a lag of first order that begins settled."""
    if lag_s <= 0.0:
        return values
    keep = float(np.exp(-period_s / lag_s))
    made, _ = lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])
    return np.asarray(made)


def delayed(values: FloatArray, steps: int) -> FloatArray:
    """Return ``values`` (n, …) later by whole samples; the first one fills the beginning.

    >>> delayed(np.array([1.0, 2.0, 3.0]), 1).tolist()
    [1.0, 1.0, 2.0]
    """
    return np.concatenate([np.repeat(values[:1], min(steps, len(values)), axis=0), values])[
        : len(values)
    ]


def transported(
    values: FloatArray, dead_time_s: float, lag_s: float, period_s: float
) -> FloatArray:
    """Return ``values`` (n,) after a dead time, between samples in a straight line, and a lag."""
    ticks = np.arange(len(values), dtype=np.float64)
    return lagged(np.interp(ticks - dead_time_s / period_s, ticks, values), lag_s, period_s)


def _columns(run: Comparison, inputs: Sequence[str]) -> FloatArray:
    return np.stack([hold(run.signals[name]) for name in inputs], axis=1)
