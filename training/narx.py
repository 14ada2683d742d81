"""The NARX: its shape, its weights in one vector, and its forward passes in float64.

``y_hat(t) = f(u(t-a) .. u(t-L), y(t-1) .. y(t-L))`` with tanh layers and a linear output, where
``a`` is 0 or 1. Everything here is in scaled units (zero mean, unit variance); physical units,
clipping of inputs and the transform of lambda live in ``prepare`` and ``export``.

Weights lie layer by layer: matrix (out, in) row by row, then the biases. The regressor holds the
inputs of the newest lag first, then the outputs of the newest lag first.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from monitor.types import FloatArray, IntArray

Layers = list[tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class Spec:
    """Shape of a NARX and the range of its scaled feedback."""

    n_inputs: int
    lags: int = 5
    hidden: tuple[int, ...] = (8, 8)
    input_lag_start: int = 1  # 1: u(t-1) is the newest input, 0: u(t) is
    y_min: float = -1e9  # predictions are clipped to this range before they are fed back
    y_max: float = 1e9

    def __post_init__(self) -> None:
        if self.n_inputs < 1 or self.lags < 1 or not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"{self}: inputs, lags and hidden layers must be positive")
        if self.input_lag_start not in (0, 1):
            raise ValueError(f"input_lag_start {self.input_lag_start}: must be 0 or 1")

    @property
    def input_lags(self) -> int:
        """Number of lags at which each input enters."""
        return self.lags - self.input_lag_start + 1

    @property
    def n_regressors(self) -> int:
        """Width of the regressor."""
        return self.input_lags * self.n_inputs + self.lags

    @property
    def sizes(self) -> tuple[int, ...]:
        """Width of every layer, the regressor first, the output last."""
        return (self.n_regressors, *self.hidden, 1)

    @property
    def n_weights(self) -> int:
        """Number of weights and biases.

        >>> Spec(n_inputs=7).n_weights
        409
        """
        return sum((a + 1) * b for a, b in zip(self.sizes[:-1], self.sizes[1:], strict=True))

    def sizes_array(self) -> IntArray:
        """Layer widths for the compiled functions."""
        return np.array(self.sizes, dtype=np.int64)


def initial_weights(spec: Spec, rng: np.random.Generator) -> FloatArray:
    """Return small random weights: variance 1/fan-in, biases spread over the tanh's range."""
    parts: list[FloatArray] = []
    for fan_in, fan_out in zip(spec.sizes[:-1], spec.sizes[1:], strict=True):
        parts.append(rng.normal(size=fan_in * fan_out) / np.sqrt(fan_in))
        parts.append(rng.uniform(-0.7, 0.7, size=fan_out))
    return np.concatenate(parts)


def layers(spec: Spec, weights: FloatArray) -> Layers:
    """Return (matrix, bias) of every layer as views into ``weights``."""
    result: Layers = []
    at = 0
    for fan_in, fan_out in zip(spec.sizes[:-1], spec.sizes[1:], strict=True):
        matrix = weights[at : at + fan_in * fan_out].reshape(fan_out, fan_in)
        at += fan_in * fan_out
        result.append((matrix, weights[at : at + fan_out]))
        at += fan_out
    return result


def forward(spec: Spec, weights: FloatArray, regressors: FloatArray) -> FloatArray:
    """Return the unclipped one-step predictions (n,) of ``regressors`` (n, n_regressors)."""
    activation = regressors
    *inner, (matrix, bias) = layers(spec, weights)
    for w, b in inner:
        activation = np.tanh(activation @ w.T + b)
    return np.asarray((activation @ matrix.T + bias)[:, 0])


def jacobian(
    spec: Spec, weights: FloatArray, regressors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return predictions (n,) and their derivatives by every weight (n, n_weights).

    Source: backpropagation of the output itself, Hagan and Menhaj, IEEE TNN 5 (1994).
    """
    n = len(regressors)
    activations = [regressors]
    stack = layers(spec, weights)
    for w, b in stack[:-1]:
        activations.append(np.tanh(activations[-1] @ w.T + b))
    predicted = (activations[-1] @ stack[-1][0].T + stack[-1][1])[:, 0]
    result = np.empty((n, spec.n_weights))
    stop = spec.n_weights
    delta = np.ones((n, 1))
    for (w, _), a in zip(reversed(stack), reversed(activations), strict=True):
        fan_out, fan_in = w.shape
        result[:, stop - fan_out : stop] = delta
        stop -= fan_out
        block = result[:, stop - fan_out * fan_in : stop].reshape(n, fan_out, fan_in)
        np.multiply(delta[:, :, None], a[:, None, :], out=block)
        stop -= fan_out * fan_in
        if stop:
            delta = (delta @ w) * (1.0 - a * a)
    return predicted, result


def regressors(spec: Spec, u: FloatArray, y: FloatArray) -> FloatArray:
    """Return the series-parallel regressors (n - lags, n_regressors) of samples lags .. n - 1.

    u, y : shapes (n, n_inputs) and (n,), scaled
    """
    n, lags = len(y), spec.lags
    taps = [u[lags - j : n - j] for j in range(spec.input_lag_start, lags + 1)]
    outputs = [y[lags - j : n - j, None] for j in range(1, lags + 1)]
    return np.concatenate([*taps, *outputs], axis=1)


@njit(nogil=True, cache=True, fastmath={"contract", "reassoc", "nsz"})
def evaluate_network(  # type: ignore[no-untyped-def]
    weights, sizes, activations
):  # pragma: no cover
    """Fill ``activations`` (n_layers, widest) from row 0 upward; return the linear output."""
    n_layers = len(sizes)
    at = 0
    output = 0.0
    for layer in range(1, n_layers):
        fan_in, fan_out = sizes[layer - 1], sizes[layer]
        bias = at + fan_in * fan_out
        below = activations[layer - 1]
        for i in range(fan_out):
            total = weights[bias + i]
            row = weights[at + i * fan_in : at + (i + 1) * fan_in]  # a view lets it vectorise
            for k in range(fan_in):
                total += row[k] * below[k]
            if layer == n_layers - 1:
                output = total
            else:
                activations[layer, i] = np.tanh(total)
        at = bias + fan_out
    return output


@njit(nogil=True, cache=True)
def fill_regressor(u, t, first_lag, lags, history, regressor):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the regressor of sample ``t``; ``history`` (lags,) is newest first."""
    at = 0
    for lag in range(first_lag, lags + 1):
        for k in range(u.shape[1]):
            regressor[at] = u[t - lag, k]
            at += 1
    for lag in range(lags):
        regressor[at] = history[lag]
        at += 1


@njit(nogil=True, cache=True)
def _simulate(  # type: ignore[no-untyped-def]
    weights, sizes, u, first_lag, lags, start, stop, history, low, high, out
):  # pragma: no cover
    activations = np.zeros((len(sizes), sizes.max()))
    past = np.empty(lags)
    for i in range(len(start)):
        past[:] = history[i]
        for t in range(start[i], stop[i]):
            fill_regressor(u, t, first_lag, lags, past, activations[0])
            y = min(max(evaluate_network(weights, sizes, activations), low), high)
            out[t] = y
            for j in range(lags - 1, 0, -1):
                past[j] = past[j - 1]
            past[0] = y


def simulate(
    spec: Spec,
    weights: FloatArray,
    u: FloatArray,
    start: IntArray,
    stop: IntArray,
    history: FloatArray,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return free-run predictions (n,), NaN outside the pieces start[i] .. stop[i] - 1.

    u : (n, n_inputs), scaled; every start must have ``lags`` samples before it
    history : (n_pieces, lags), the output before each start, newest first, scaled
    """
    if len(start) and (start.min() < spec.lags or stop.max() > len(u)):
        raise ValueError(f"pieces must lie within {spec.lags} .. {len(u)}")
    result = np.full(len(u), np.nan) if out is None else out
    _simulate(
        weights, spec.sizes_array(), u, spec.input_lag_start, spec.lags,
        start, stop, np.clip(history, spec.y_min, spec.y_max), spec.y_min, spec.y_max, result,
    )  # fmt: skip
    return result
