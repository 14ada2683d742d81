"""How every linear model is run and scored: free run after the same first samples."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from monitor.base.types import FloatArray
from training.studies.paper.linear.regressors import Stretch


class LinearModel(Protocol):
    """What ARX, state space and output error models have in common."""

    @property
    def n_parameters(self) -> int:
        """Number of estimated coefficients."""

    @property
    def stable(self) -> bool:
        """Whether the free run forgets its start."""

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """Return the free run (n,) that begins after the measured outputs ``y0``."""

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step predictions (n,)."""


def free_runs(model: LinearModel, records: Sequence[Stretch], skip: int) -> list[FloatArray]:
    """Return each stretch's free run (n,); the first ``skip`` outputs are the measured ones."""
    return [model.simulate(u, y[:skip]) for u, y in records]


def free_run_error(model: LinearModel, records: Sequence[Stretch], skip: int) -> float:
    """Return the mean squared free-run error after the first ``skip`` samples; inf if unstable."""
    if not model.stable:
        return float("inf")
    runs = free_runs(model, records, skip)
    errors = [y[skip:] - run[skip:] for (_, y), run in zip(records, runs, strict=True)]
    return float(np.mean(np.concatenate(errors) ** 2))
