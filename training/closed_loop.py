"""Errors and exact sensitivities of the NARX that runs on its own predictions.

With S_t the derivative of y_hat(t) by all weights, S_t = df/dw + sum_j df/dy(t-j) S_(t-j), which
is carried through time sample by sample. A measured or random history has S = 0, and so has a
prediction that was clipped. Horizon 1 is series-parallel training.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from monitor.types import FloatArray, IntArray
from training import kernels
from training.narx import Spec, input_regressors

CHUNK = 1500  # rows of the Jacobian that stay in the cache together


@dataclass(frozen=True, slots=True)
class Pieces:
    """Stretches of the samples that are run freely, each from its own history."""

    start: IntArray  # (n_pieces,) first predicted sample
    stop: IntArray  # (n_pieces,)
    skip: IntArray  # (n_pieces,) first samples that are run and not scored
    history: FloatArray  # (n_pieces, lags) outputs before start, newest first, scaled

    def __add__(self, other: "Pieces") -> "Pieces":
        return Pieces(
            np.concatenate([self.start, other.start]),
            np.concatenate([self.stop, other.stop]),
            np.concatenate([self.skip, other.skip]),
            np.concatenate([self.history, other.history]),
        )


@dataclass(frozen=True, slots=True)
class Samples:
    """Scaled samples of all recordings one after another."""

    u: FloatArray  # (n, n_inputs), finite
    y: FloatArray  # (n,), finite; where it was not valid its weight is 0
    weight: FloatArray  # (n,) of the squared error, 0 is not scored


class ClosedLoop:
    """Weighted mean squared simulation error over pieces, and its normal equations.

    The Jacobian is summed in float32 blocks, the sums are float64: an error of about 1e-7 of the
    entries at half the time. ``dtype=numpy.float64`` is exact.
    """

    def __init__(
        self, spec: Spec, samples: Samples, pieces: Pieces, dtype: type[np.floating] = np.float32
    ) -> None:
        if len(pieces.start) and (
            pieces.start.min() < spec.memory or pieces.stop.max() > len(samples.y)
        ):
            raise ValueError(f"pieces must lie within {spec.memory} .. {len(samples.y)}")
        self.spec, self.samples, self.dtype = spec, samples, dtype
        self._x = input_regressors(spec, samples.u)
        history = np.clip(pieces.history, spec.y_min, spec.y_max)
        self.pieces = Pieces(pieces.start, pieces.stop, pieces.skip, history)
        self._root_weight = np.sqrt(samples.weight)
        scored = [
            samples.weight[a + s : b]
            for a, b, s in zip(pieces.start, pieces.stop, pieces.skip, strict=True)
        ]
        self.total_weight = float(sum(w.sum() for w in scored))
        self.n_samples = int((pieces.stop - pieces.start).sum())
        if self.total_weight <= 0:
            raise ValueError("no sample is scored")

    def cost(self, weights: FloatArray) -> float:
        """Return the weighted mean squared error."""
        return float(self.squares(weights).sum()) / self.total_weight

    def squares(self, weights: FloatArray) -> FloatArray:
        """Return the weighted sum of squared errors of every piece (n_pieces,)."""
        s, p, q = self.spec, self.pieces, self.samples
        total: FloatArray = kernels.cost(
            weights, s.sizes_array(), self._x, q.y, q.weight, s.lags,
            s.y_min, s.y_max, p.start, p.stop, p.skip, p.history,
        )  # fmt: skip
        return total

    def blocks(self, weights: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield weighted Jacobian rows (m, n_weights) and errors (m,); the buffers are reused."""
        s, p, q = self.spec, self.pieces, self.samples
        jacobian = np.empty((CHUNK, s.n_weights), dtype=self.dtype)
        error = np.empty(CHUNK, dtype=self.dtype)
        cursor = np.array([0, -1, 0], dtype=np.int64)
        past, ring = np.zeros(s.lags), np.zeros((s.lags + 1, s.n_weights))
        while cursor[0] < len(p.start):
            rows = kernels.fill(
                weights, s.sizes_array(), self._x, q.y, self._root_weight, s.lags,
                s.y_min, s.y_max, p.start, p.stop, p.skip, p.history, cursor, past, ring,
                jacobian, error,
            )  # fmt: skip
            if rows:
                yield jacobian[:rows], error[:rows]

    def normal(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the cost, J'J (n, n) and J'e (n,), all divided by the total weight."""
        n = self.spec.n_weights
        hessian, gradient, total = np.zeros((n, n)), np.zeros(n), 0.0
        for jacobian, error in self.blocks(weights):
            hessian += jacobian.T @ jacobian
            gradient += jacobian.T @ error
            total += float(np.sum(error.astype(np.float64) ** 2))
        w = self.total_weight
        return total / w, hessian / w, gradient / w
