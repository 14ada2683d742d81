"""One-step training of the same network, by this project and by other packages.

Every function takes the same data and initial weights, in the layout of
``training.narx.network``, and returns weights in that layout.
"""

import contextlib
import importlib
import io
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import ModuleType

import numpy as np
from scipy.optimize import least_squares

from training.narx.algorithms.lm import minimise
from training.narx.algorithms.objectives import ClosedLoop, Pieces
from training.narx.network import Spec, forward, layers, regressors
from training.recordings.samples.preparation import Samples


@dataclass(frozen=True)
class TrainingCase:
    """Training and held-out drive, scaled to zero mean and unit variance of the training drive."""

    title: str
    spec: Spec
    u: np.ndarray
    y: np.ndarray
    held_out_u: np.ndarray
    held_out_y: np.ndarray

    @cached_property
    def phi(self) -> np.ndarray:
        return regressors(self.spec, self.u, self.y)

    @property
    def target(self) -> np.ndarray:
        return self.y[self.spec.lags :]

    def error(self, horizon: int = 1, dtype: type[np.floating] = np.float32) -> ClosedLoop:
        """Return the free-run error over pieces of ``horizon`` samples."""
        start = np.arange(self.spec.lags, len(self.y), horizon)
        history = self.y[start[:, None] - np.arange(1, self.spec.lags + 1)]
        pieces = Pieces(start, np.minimum(start + horizon, len(self.y)), 0 * start, history)
        return ClosedLoop(self.spec, Samples(self.u, self.y, np.ones(len(self.y))), pieces, dtype)

    def first(self, n: int) -> "TrainingCase":
        """Return the case with the first ``n`` training samples."""
        return replace(self, u=self.u[:n], y=self.y[:n])


@dataclass
class TrainedRun:
    """What a package did from one start."""

    iterations: int
    cpu_s: float
    wall_s: float
    weights: np.ndarray
    history: list[tuple[float, float]] = field(default_factory=list)  # CPU seconds, training RMSE


class MissingError(Exception):
    """The package is not installed."""


def package(name: str) -> ModuleType:
    """Return the imported package; raises MissingError."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingError(
            f"{name} is missing ({error}); pip install --no-deps -r benchmarks/requirements.txt"
        ) from error


def timed(work: Callable[[], tuple[int, np.ndarray]]) -> TrainedRun:
    """Return what ``work`` returned, iterations and weights, with its time."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        iterations, weights = work()
    return TrainedRun(
        iterations, time.process_time() - cpu_s, time.perf_counter() - wall_s, weights
    )


def ours(case: TrainingCase, start: np.ndarray, iterations: int) -> TrainedRun:
    """Levenberg–Marquardt of this project, one step ahead."""
    began, ends_s, costs = time.process_time(), list[float](), list[float]()

    def begins() -> bool:
        ends_s.append(time.process_time() - began)  # of the epoch before
        return True

    def work() -> tuple[int, np.ndarray]:
        found = minimise(case.error(), start, begins=begins, epochs=iterations)
        costs.extend(found.costs[1:])
        return len(costs), found.weights

    run = timed(work)
    run.history = list(zip(ends_s[1:], np.sqrt(costs), strict=False))
    return run


def _to_pyrenn(spec: Spec, weights: np.ndarray) -> np.ndarray:
    """Return the weights layer by layer, each matrix column by column, then its biases."""
    parts = [[matrix.ravel(order="F"), bias] for matrix, bias in layers(spec, weights)]
    return np.concatenate([array for part in parts for array in part])


def _from_pyrenn(spec: Spec, weights: np.ndarray) -> np.ndarray:
    order = _to_pyrenn(spec, np.arange(spec.n_weights)).astype(int)
    back = np.empty(spec.n_weights)
    back[order] = weights
    return back


def pyrenn_lm(case: TrainingCase, start: np.ndarray, iterations: int) -> TrainedRun:
    """Levenberg–Marquardt of pyrenn on the regressors."""
    pyrenn = package("pyrenn")
    net = pyrenn.CreateNN([case.phi.shape[1], *case.spec.hidden, 1])
    net["normP"], net["normY"] = np.ones(case.phi.shape[1]), np.ones(1)  # it is scaled already
    net["w"] = _to_pyrenn(case.spec, start)

    def work() -> tuple[int, np.ndarray]:
        trained = pyrenn.train_LM(case.phi.T, case.target[None], net, k_max=iterations)
        return iterations, _from_pyrenn(case.spec, trained["w"])

    return timed(work)


def scipy_lm(case: TrainingCase, start: np.ndarray, iterations: int) -> TrainedRun:
    """Run MINPACK's Levenberg–Marquardt through scipy, with the Jacobian of this project."""

    def residual(weights: np.ndarray) -> np.ndarray:
        return forward(case.spec, weights, case.phi) - case.target

    def derivative(weights: np.ndarray) -> np.ndarray:
        rows = case.error(1, np.float64).blocks(weights)
        return np.concatenate([each.copy() for each, _ in rows])

    def work() -> tuple[int, np.ndarray]:
        found = least_squares(residual, start, max_nfev=iterations, method="lm", jac=derivative)
        return int(found.njev or found.nfev), found.x

    return timed(work)
