"""State space models by a subspace method over several recordings.

The method is predictor-based subspace identification (PBSID). A long ARX model gives the
predictor's Markov parameters; the row space of their Hankel matrix times the past data is that of
the states; three least-squares steps give the matrices. The method also works on data from a
closed loop, like lambda.
Source: Chiuso, The role of vector autoregressive modeling in predictor-based subspace
identification, Automatica 43 (2007) 1034-1048.

No library is used: nfoursid 1.0.2 and sippy_unipi 1.0.1 take a single unbroken record, and
python-control has no method for inputs and noise. Here everything is computed from the triangular
factor of the lagged samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.signal import ss2tf

from monitor.base.types import FloatArray
from training.narx.linear.arx import Arx
from training.narx.linear.free_run import free_run_error
from training.narx.linear.regressors import Stretch, Triangle


@dataclass(frozen=True, slots=True)
class StateSpace:
    """x(t+1) = A x + B v + K e, y = C x + D v + e with v = [u, 1]; e is white."""

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, k + 1)
    C: FloatArray  # (n,)
    D: FloatArray  # (k + 1,)
    K: FloatArray  # (n,)

    @property
    def order(self) -> int:
        """The number of states."""
        return len(self.C)

    @property
    def n_parameters(self) -> int:
        """The number of free coefficients; a change of the states' basis is not counted."""
        return self.order * (self.B.shape[1] + 2) + len(self.D)

    @property
    def stable(self) -> bool:
        """Whether the free run and the Kalman filter forget their start."""
        filtered = self.A - np.outer(self.K, self.C)
        return bool(np.abs(np.linalg.eigvals([self.A, filtered])).max() < 1.0)

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """Return the free run (n,); a Kalman filter over the outputs ``y0`` sets its state."""
        result = self._filtered(u, y0)
        result[: len(y0)] = y0
        return result

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step predictions (n,)."""
        return self._filtered(u, y)

    def _filtered(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the predictions (n,) of the Kalman filter; without outputs it runs freely.

        The filter starts in the steady state of the first sample.
        """
        v = np.column_stack([u, np.ones(len(u))])
        inflow = self.B @ v[0] + self.K * (y[0] - self.D @ v[0])
        filtered = self.A - np.outer(self.K, self.C)
        start = np.linalg.lstsq(np.eye(self.order) - filtered, inflow, rcond=None)[0]
        matrices = (self.A, self.B, self.C, self.D, self.K)
        return np.asarray(_run(*matrices, start, v, np.ascontiguousarray(y)))

    def transfer(self) -> Arx:
        """Return the model as polynomials; ``a`` of the result is the denominator."""
        n_inputs = len(self.D) - 1
        a = np.asarray(np.poly(self.A).real, dtype=np.float64)
        b = np.zeros((n_inputs, self.order + 1))
        for i in range(n_inputs + 1):
            column, feed = self.B[:, i : i + 1], self.D[i : i + 1, None]
            numerator = ss2tf(self.A, column, self.C[None, :], feed)[0][0]
            if i < n_inputs:
                b[i] = numerator
        return Arx(a[1:], b, (0,) * n_inputs, float(numerator.sum()))


@njit(nogil=True, cache=True)
def _run(A, B, C, D, K, start, v, y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return the predictions (n,); the innovation corrects the state while ``y`` lasts."""
    n = len(C)
    x, after, out = start.copy(), np.empty(n), np.empty(len(v))
    for t in range(len(v)):
        predicted = 0.0
        for j in range(v.shape[1]):
            predicted += D[j] * v[t, j]
        for i in range(n):
            predicted += C[i] * x[i]
        out[t] = predicted
        innovation = y[t] - predicted if t < len(y) else 0.0
        for i in range(n):
            total = K[i] * innovation
            for j in range(v.shape[1]):
                total += B[i, j] * v[t, j]
            for j in range(n):
                total += A[i, j] * x[j]
            after[i] = total
        x, after = after, x
    return out


@dataclass(frozen=True, slots=True)
class Subspace:
    """State space models of every order from one decomposition."""

    singular_values: FloatArray  # (past,) singular values of the predicted future outputs
    models: tuple[StateSpace, ...]  # order 1 upward

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


def _realise(x: FloatArray, x_next: FloatArray, factor: FloatArray, feed: list[int]) -> StateSpace:
    n, v, y = x.shape[1], factor[:, feed], factor[:, 1]
    output = np.linalg.lstsq(np.hstack([x, v]), y, rcond=None)[0]
    innovation = y - np.hstack([x, v]) @ output
    theta = np.linalg.lstsq(np.hstack([x, v, innovation[:, None]]), x_next, rcond=None)[0].T
    A, B, K = theta[:, :n], theta[:, n:-1], theta[:, -1]
    return StateSpace(*(np.ascontiguousarray(m) for m in (A, B, output[:n], output[n:], K)))


def best_state_space(
    found: Subspace, validate: Sequence[Stretch], skip: int
) -> tuple[StateSpace, list[float]]:
    """Return the model with the least free-run error on ``validate``, and the error of all orders.

    skip : number of first samples of a stretch that set the state and are not scored
    Errors are mean squared errors, inf for an unstable model.
    """
    errors = [free_run_error(model, validate, skip) for model in found.models]
    return found.models[int(np.argmin(errors))], errors
