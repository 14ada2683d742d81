"""The error that training minimises: that of free runs over pieces of the samples.

It has the mean squared error as ``cost`` and the ``normal`` equations of its linearisation for
Levenberg–Marquardt.

A free run feeds its own predictions back; over pieces of one sample it is the one-step error of
series-parallel training. With S_t the derivative of y_hat(t) by all weights,
S_t = df/dw + sum_j df/dy(t-j) S_(t-j), which is carried through time sample by sample. A measured
or random history has S = 0, and so has a prediction that was clipped.
"""

from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.narx import kernels
from training.narx.network import Spec, input_regressors
from training.recordings.samples.preparation import Samples

CHUNK = 1500  # rows of the Jacobian that stay in the cache together


def measured_history(samples: Samples, lags: int, start: IntArray) -> FloatArray:
    """Return (n_pieces, lags) measured outputs before every start, newest first, scaled."""
    return np.asarray(samples.y[start[:, None] - np.arange(1, lags + 1)])


@dataclass(frozen=True, slots=True)
class Pieces:
    """Stretches of the samples that are run freely, each from its own history."""

    start: IntArray  # (n_pieces,) first predicted sample
    stop: IntArray  # (n_pieces,)
    skip: IntArray  # (n_pieces,) first samples that are run and not scored
    history: FloatArray  # (n_pieces, lags) outputs before start, newest first, scaled

    def __add__(self, other: "Pieces") -> "Pieces":
        both = zip(astuple(self), astuple(other), strict=True)
        return Pieces(*map(np.concatenate, both))


class ClosedLoop:
    """Weighted mean squared free-run error over pieces.

    dtype : of the Jacobian; float32 rounds its entries to 1e-7 at half the time, errors and sums
        stay float64
    decay : this times every squared weight, except those of the linear path, is added to the error
    Raises ValueError if pieces leave the samples or their weights sum to zero.
    """

    def __init__(
        self,
        spec: Spec,
        samples: Samples,
        pieces: Pieces,
        dtype: type[np.floating] = np.float32,
        decay: float = 0.0,
    ) -> None:
        if len(pieces.start) and (
            pieces.start.min() < spec.memory or pieces.stop.max() > len(samples.y)
        ):
            raise ValueError(f"pieces must lie within {spec.memory} .. {len(samples.y)}")
        self.spec, self.samples, self.dtype = spec, samples, dtype
        self._decay = np.full(spec.n_weights, decay)  # of every weight squared
        if spec.linear_path:
            self._decay[-spec.n_regressors :] = 0.0
        history, ends = np.clip(pieces.history, spec.y_min, spec.y_max), (spec.y_min, spec.y_max)
        self.pieces = Pieces(pieces.start, pieces.stop, pieces.skip, history)
        sizes = np.array(spec.sizes, dtype=np.int64)
        self._network = (sizes, input_regressors(spec, samples.u), samples.y)
        self._run = (spec.lags, *ends, pieces.start, pieces.stop, pieces.skip, history)
        self._root_weight = np.sqrt(samples.weight)
        scored = zip(pieces.start, pieces.stop, pieces.skip, strict=True)
        self.weights = np.array([samples.weight[a + s : b].sum() for a, b, s in scored])
        self.total_weight = float(self.weights.sum())
        self.n_samples = int((pieces.stop - pieces.start).sum())
        if self.total_weight <= 0:
            raise ValueError("no sample is scored")

    def cost(self, weights: FloatArray) -> float:
        """Return the weighted mean squared error and the decay."""
        penalty = float(self._decay @ weights**2)
        return float(self.squares(weights).sum()) / self.total_weight + penalty

    def score(self, weights: FloatArray) -> float:
        """Return the mean over pieces of their weighted RMSE, scaled units.

        One odd piece weighs less in it than in the RMSE over all samples.
        """
        return float(self.weights @ self.errors(weights)) / self.total_weight

    def errors(self, weights: FloatArray) -> FloatArray:
        """Return the weighted RMSE of every piece (n_pieces,), scaled units."""
        return np.sqrt(self.squares(weights) / self.weights)

    def squares(self, weights: FloatArray) -> FloatArray:
        """Return the weighted sum of squared errors of every piece (n_pieces,)."""
        weight = self.samples.weight
        return np.asarray(kernels.cost(weights, self._network, weight, self._run))

    def blocks(self, weights: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield weighted Jacobian rows (m, n_weights) and errors (m,); the buffers are reused."""
        s, weight = self.spec, self._root_weight
        jacobian = np.empty((CHUNK, s.n_weights), dtype=self.dtype)
        error = np.empty(CHUNK, dtype=self.dtype)
        cursor = np.array([0, -1, 0], dtype=np.int64)
        kept = (cursor, np.zeros(s.lags), np.zeros((s.lags + 1, s.n_weights)), jacobian, error)
        while cursor[0] < len(self.pieces.start):
            rows = kernels.fill(weights, self._network, weight, self._run, kept)
            if rows:
                yield jacobian[:rows], error[:rows]

    def normal(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the cost, J'J (n, n) and J'e (n,), all divided by the total weight."""
        n = self.spec.n_weights
        hessian, gradient, total = np.zeros((n, n)), np.zeros(n), 0.0
        for J, error in self.blocks(weights):
            with np.errstate(over="ignore", invalid="ignore"):  # of a run that explodes
                hessian += J.T @ J
                gradient += J.T @ error
            total += float(np.sum(error.astype(np.float64) ** 2))
        w = self.total_weight
        hessian /= w
        hessian[np.diag_indices(n)] += self._decay
        penalty = float(self._decay @ weights**2)
        return total / w + penalty, hessian, gradient / w + self._decay * weights


def one_step(
    spec: Spec, samples: Samples, rows: IntArray, dtype: type[np.floating] = np.float32
) -> ClosedLoop:
    """Return the one-step error at ``rows``, each predicted from measured outputs."""
    history = measured_history(samples, spec.lags, rows)
    return ClosedLoop(spec, samples, Pieces(rows, rows + 1, np.zeros_like(rows), history), dtype)
