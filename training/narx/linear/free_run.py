"""Free run of a linear model and its error, after the same first samples for every model."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from monitor.base.types import FloatArray
from training.narx.linear.regressors import Stretch


class LinearModel(Protocol):
    """Interface shared by ARX, state space and output error models."""

    @property
    def n_parameters(self) -> int:
        """The number of estimated coefficients."""

    @property
    def stable(self) -> bool:
        """Whether the free run forgets its start."""

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """Return the free run (n,) over inputs ``u`` (n, k).

        y0 : (m,) first measured outputs; they set the state and are returned unchanged
        """

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step predictions (n,) from inputs (n, k) and measured outputs (n,)."""


def free_runs(model: LinearModel, records: Sequence[Stretch], skip: int) -> list[FloatArray]:
    """Return the free run (n,) of every stretch; its first ``skip`` outputs are measured ones.

    A stretch of no more samples is all measured.
    """
    return [model.simulate(u, y[:skip]) if len(y) > skip else y for u, y in records]


def free_run_error(model: LinearModel, records: Sequence[Stretch], skip: int) -> float:
    """Return the mean squared free-run error, inf for an unstable model.

    skip : number of first samples of a stretch that set the state and are not scored
    """
    if not model.stable:
        return float("inf")
    runs = free_runs(model, records, skip)
    errors = [y[skip:] - run[skip:] for (_, y), run in zip(records, runs, strict=True)]
    return float(np.mean(np.concatenate(errors) ** 2))
