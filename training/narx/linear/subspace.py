"""State space models by a subspace method over several recordings.

The method is predictor-based subspace identification (PBSID). A long ARX model gives the
predictor's Markov parameters; the row space of their Hankel matrix times the past data is that of
the states; three least-squares steps give the matrices. The method also works on data from a
closed loop, like lambda.
Source: Chiuso, The role of vector autoregressive modeling in predictor-based subspace
identification, Automatica 43 (2007) 1034-1048.

No library is used: nfoursid 1.0.2 and sippy_unipi 1.0.1 take a single unbroken record, and
python-control has no method for inputs and noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import ss2tf

from monitor.base.types import FloatArray
from training.narx.linear.models import LinearModel
from training.narx.linear.regressors import Triangle


@dataclass(frozen=True, slots=True)
class Subspace:
    """State space models of every order from one decomposition, as polynomials."""

    singular_values: FloatArray  # (past,) singular values of the predicted future outputs
    models: tuple[LinearModel, ...]  # order 1 upward

    @property
    def order_by_gap(self) -> int:
        """The order after which the logarithms of the singular values fall most."""
        s = np.log(np.maximum(self.singular_values, 1e-12 * self.singular_values[0]))
        return int(np.argmax(s[: len(self.models)] - s[1 : len(self.models) + 1])) + 1


def subspace(data: Triangle, past: int, max_order: int) -> Subspace:
    """Return the state space models of order 1 to ``max_order``.

    data : condensed samples with at least ``past`` lags of inputs and output
    past : number of past samples from which the states are formed, larger than ``max_order``
    """
    inputs, k = range(data.n_inputs), data.n_inputs
    lags = [[*data.y_at(j), *(c for i in inputs for c in data.u_at(i, j))] for j in range(past + 1)]
    feed = [c for i in inputs for c in data.u_at(i, 0)] + [0]
    long_arx = data.solve([*feed, *(c for lag in lags[1:] for c in lag)])
    markov = long_arx[k + 1 :].reshape(past, k + 1)  # of lag 1 .. past
    hankel = np.zeros((past, past, k + 1))
    for row in range(past):
        hankel[row, : past - row] = markov[row:]
    wide = hankel.reshape(past, -1)
    before = data.factor[:, [c for lag in lags[1:] for c in lag]]
    after = data.factor[:, [c for lag in lags[:-1] for c in lag]]
    left, singular_values, _ = np.linalg.svd(wide @ before.T, full_matrices=False)
    models = []
    for n in range(1, max_order + 1):
        states = (left[:, :n] / np.sqrt(singular_values[:n])).T @ wide
        models.append(_realise(before @ states.T, after @ states.T, data.factor, feed))
    return Subspace(singular_values / np.sqrt(data.rows), tuple(models))


def _realise(x: FloatArray, x_next: FloatArray, factor: FloatArray, feed: list[int]) -> LinearModel:
    """Return x(t+1) = A x + B v + K e, y = C x + D v + e with v = [u, 1] as polynomials."""
    n, v, y = x.shape[1], factor[:, feed], factor[:, 1]
    output = np.linalg.lstsq(np.hstack([x, v]), y, rcond=None)[0]
    innovation = y - np.hstack([x, v]) @ output
    theta = np.linalg.lstsq(np.hstack([x, v, innovation[:, None]]), x_next, rcond=None)[0].T
    A, B, K, C, D = theta[:, :n], theta[:, n:-1], theta[:, -1], output[:n], output[n:]
    sides = [ss2tf(A, B[:, [i]], C[None], D[[i], None])[0][0] for i in range(len(D))]
    a, c = (np.poly(m).real[1:].astype(np.float64) for m in (A, A - np.outer(K, C)))
    return LinearModel(a, np.array(sides[:-1]), (0,) * (len(D) - 1), float(sides[-1].sum()), c)
