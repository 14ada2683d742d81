"""The NARX: its shape, its weights in one vector, and its forward passes in float64.

``y_hat(t) = f(u(t-a) .. u(t-L), y(t-1) .. y(t-L))`` with tanh layers and a linear output, where
``a`` is 0 or 1. Everything here is in scaled units (zero mean, unit variance); physical units,
clipping of inputs and the transform of lambda live in ``prepare`` and ``export``.

Weights lie layer by layer: matrix (out, in) row by row, then the biases. The regressor holds the
inputs of the newest lag first, then the outputs of the newest lag first.
"""

from dataclasses import dataclass

import numpy as np

from monitor.types import FloatArray, IntArray
from training import kernels

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


def _activations(spec: Spec, weights: FloatArray, regressors: FloatArray) -> list[FloatArray]:
    """Return every layer's values (width, n), samples side by side, the regressors first."""
    *inner, (matrix, bias) = layers(spec, weights)
    values = [regressors.T]
    for w, b in inner:
        values.append(np.tanh(w @ values[-1] + b[:, None]))
    return [*values, matrix @ values[-1] + bias[:, None]]


def forward(spec: Spec, weights: FloatArray, regressors: FloatArray) -> FloatArray:
    """Return the unclipped one-step predictions (n,) of ``regressors`` (n, n_regressors)."""
    return _activations(spec, weights, regressors)[-1][0]


def jacobian(
    spec: Spec,
    weights: FloatArray,
    regressors: FloatArray,
    scale: FloatArray | None = None,
    dtype: type[np.floating] = np.float64,
) -> tuple[FloatArray, FloatArray]:
    """Return predictions (n,) and their derivatives by every weight (n, n_weights).

    scale : (n,), multiplies the derivatives; one if None
    dtype : of the derivatives; predictions and back-propagated slopes are float64 always
    Source: backpropagation of the output itself, Hagan and Menhaj, IEEE TNN 5 (1994).
    """
    *activations, predicted = _activations(spec, weights, regressors)
    n = len(regressors)
    result = np.empty((spec.n_weights, n), dtype)
    stop = spec.n_weights
    delta = np.ones((1, n)) if scale is None else scale[None]
    for (w, _), a in zip(reversed(layers(spec, weights)), reversed(activations), strict=True):
        fan_out, fan_in = w.shape
        slope, below = delta.astype(dtype, order="C"), a.astype(dtype, order="C")
        result[stop - fan_out : stop] = slope
        stop -= fan_out
        block = result[stop - fan_out * fan_in : stop].reshape(fan_out, fan_in, n)
        np.multiply(slope[:, None], below[None], out=block)
        stop -= fan_out * fan_in
        if stop:
            delta = (w.T @ delta) * (1.0 - a * a)
    return predicted[0], result.T


def regressors(spec: Spec, u: FloatArray, y: FloatArray) -> FloatArray:
    """Return the series-parallel regressors (n - lags, n_regressors) of samples lags .. n - 1.

    u, y : shapes (n, n_inputs) and (n,), scaled
    """
    n, lags = len(y), spec.lags
    taps = [u[lags - j : n - j] for j in range(spec.input_lag_start, lags + 1)]
    outputs = [y[lags - j : n - j, None] for j in range(1, lags + 1)]
    return np.concatenate([*taps, *outputs], axis=1)


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
    kernels.simulate(
        weights, spec.sizes_array(), u, spec.input_lag_start, spec.lags,
        start, stop, np.clip(history, spec.y_min, spec.y_max), spec.y_min, spec.y_max, result,
    )  # fmt: skip
    return result
