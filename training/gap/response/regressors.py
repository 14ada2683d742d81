"""Columns from which a linear fit predicts any output: filtered inputs and functions of them.

Every input passes a bank of first-order lags and a few dead times; random smooth functions of the
bank bend it. The fit is linear, so leaving a run out costs one solve.
Source: Rahimi and Recht, Random features for large-scale kernel machines, NIPS 2007.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import delayed, lag

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
        mean, spread = values.mean(axis=0), np.maximum(values.std(axis=0), 1e-12)
        return cls(tuple(inputs), low, high, mean, spread)

    def __call__(self, run: Comparison) -> FloatArray:
        """Return the columns (n, m) of one recording; the first is a constant."""
        values = np.clip(_columns(run, self.inputs), self.low, self.high)
        scaled = (values - self.mean) / self.spread
        steps = [max(round(s / run.period_s), 1) for s in DEAD_TIMES_S]
        columns = np.ascontiguousarray(scaled.T)
        bank = np.column_stack(
            [
                *(lag(x, s, run.period_s) for s in LAGS_S for x in columns),
                *(delayed(x, k) for k in dict.fromkeys(steps) for x in columns),
            ]
        )
        rng = np.random.default_rng(SEED)
        shape = (bank.shape[1], FUNCTIONS)
        weights = rng.standard_normal(shape) * (rng.random(shape) < SHARE) * SLOPE
        bent = np.tanh(bank @ weights + rng.uniform(-OFFSETS, OFFSETS, FUNCTIONS))
        return np.column_stack([np.ones(len(bank)), bank, bent])


def _columns(run: Comparison, inputs: Sequence[str]) -> FloatArray:
    return np.stack([run.signals[name] for name in inputs], axis=1)
