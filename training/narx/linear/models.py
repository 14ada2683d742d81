"""Linear models as polynomials of the delay, their free run and its error.

``A(q) y(t) = offset + B(q) u(t) + C(q) e(t)`` with white e; A and C begin with 1. C = 1 is an ARX
model, C = A an output error model, any C the innovations form of a state space model.
Source: Ljung, System Identification, 2nd ed., section 4.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter, lfiltic

from monitor.base.types import FloatArray

Stretch = tuple[FloatArray, FloatArray]  # inputs (n, k) and output (n,) on one sample grid


@dataclass(frozen=True, slots=True)
class LinearModel:
    """A linear model in the units of its samples."""

    a: FloatArray  # (na,) coefficients of y(t-1) .. y(t-na), on the left side of the equation
    b: FloatArray  # (k, nb) coefficients of the k inputs
    delays: tuple[int, ...]  # (k,) dead time of each input in samples
    offset: float
    c: FloatArray = field(default_factory=lambda: np.zeros(0))  # (nc,) of e(t-1) .. e(t-nc)

    @property
    def lags(self) -> int:
        """The number of past samples that the model needs."""
        return max(len(self.a), len(self.c), max(self.delays) + self.b.shape[1] - 1)

    @property
    def n_parameters(self) -> int:
        """The number of estimated coefficients; an output error model's C is its A."""
        return len(self.a) + self.b.size + 1 + len(self.c) * (not np.array_equal(self.a, self.c))

    @property
    def poly(self) -> FloatArray:
        """The polynomial A = [1, a1 ..]."""
        return np.concatenate([[1.0], self.a])

    @property
    def stable(self) -> bool:
        """Whether free run and one-step prediction forget their start."""
        roots = np.concatenate([np.roots([1.0, *self.a]), np.roots([1.0, *self.c])])
        return bool(np.all(np.abs(roots) < 1.0))

    def _drive(self, u: FloatArray) -> FloatArray:
        """Return offset + B u (n,); the values before sample ``lags`` are not valid."""
        total = np.full(len(u), self.offset)
        for i, (delay, b) in enumerate(zip(self.delays, self.b, strict=True)):
            total += np.convolve(np.concatenate([np.zeros(delay), b]), u[:, i])[: len(u)]
        return total

    def errors(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step errors e (n,), 0 at the first ``lags`` samples."""
        coloured = np.convolve(self.poly, y)[: len(y)] - self._drive(u)
        coloured[: self.lags] = 0.0
        return np.asarray(lfilter([1.0], [1.0, *self.c], coloured))

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """Return the free run (n,) over inputs ``u`` (n, k).

        y0 : (m,) first measured outputs, m at least ``lags``; they set the state and are returned
            unchanged
        Raises ValueError if ``y0`` is too short.
        """
        m = len(y0)
        if m < self.lags:
            raise ValueError(f"{m} first outputs, the model needs {self.lags}")
        errors = np.zeros(len(u))
        errors[:m] = self.errors(u[:m], y0[: len(u)])
        drive = self._drive(u) + np.convolve([1.0, *self.c], errors)[: len(u)]
        past = lfiltic([1.0], self.poly, np.asarray(y0)[::-1][: len(self.a)])
        free, _ = lfilter([1.0], self.poly, drive[m:], zi=past)
        return np.concatenate([y0, free])[: len(u)]


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
