"""The NARX: its shape, its weights in one vector, and its forward passes in float64.

``y_hat(t) = f(u(t-a) .. u(t-L), y(t-1) .. y(t-L))`` with tanh layers and a linear output, where
``a`` is 0 or 1. Inputs may instead enter as means over boxes of lags, narrow for the newest and
wide for the old ones, so that a long memory needs few weights; and a linear path may lead from
the regressor past the layers to the output. Everything here is in scaled units (zero mean, unit
variance); ``recordings.samples`` and ``export`` know the physical ones.

Weights lie layer by layer: matrix (out, in) row by row, then the biases; the linear path comes
last. The regressor holds the inputs of the newest box first, then the outputs of the newest lag
first.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.narx import kernels

Layers = list[tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class Spec:
    """Shape of a NARX and the range of its scaled feedback."""

    n_inputs: int
    lags: int = 5  # of the output: it enters at lags 1 .. lags
    hidden: tuple[int, ...] = (8, 8)  # () is a linear model
    input_lag_start: int = 1  # 1: u(t-1) is the newest input, 0: u(t) is
    y_min: float = -1e9  # predictions are clipped to this range before they are fed back
    y_max: float = 1e9
    input_boxes: tuple[tuple[int, int], ...] = ()  # first lag, stop; (): one box per lag
    linear_path: bool = False

    def __post_init__(self) -> None:
        if self.n_inputs < 1 or self.lags < 1 or min(self.hidden, default=1) < 1:
            raise ValueError(f"{self}: inputs, lags and hidden layers must be positive")
        if self.input_lag_start not in (0, 1):
            raise ValueError(f"input_lag_start {self.input_lag_start}: must be 0 or 1")

    @property
    def boxes(self) -> tuple[tuple[int, int], ...]:
        """First lag and stop of every box of input lags."""
        single = range(self.input_lag_start, self.lags + 1)
        return self.input_boxes or tuple((lag, lag + 1) for lag in single)

    @property
    def memory(self) -> int:
        """Longest lag of inputs and output, the number of samples before the first prediction."""
        return max(self.lags, self.boxes[-1][1] - 1)

    @property
    def n_regressors(self) -> int:
        """Width of the regressor."""
        return len(self.boxes) * self.n_inputs + self.lags

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
        inner = sum((a + 1) * b for a, b in pairwise(self.sizes))
        return inner + (self.n_regressors if self.linear_path else 0)


def describe(spec: Spec) -> str:
    """Return the shape in words.

    >>> describe(Spec(n_inputs=7))
    'inputs at lags 1 to 5, output at lags 1 to 5, tanh layers of 8 and 8'
    """
    first, last = spec.boxes[0][0], spec.boxes[-1][1] - 1
    boxed = f" in {len(spec.boxes)} boxes" if len(spec.boxes) <= last - first else ""
    layers = f"tanh layers of {' and '.join(map(str, spec.hidden))}" if spec.hidden else "linear"
    path = " beside a linear path" if spec.linear_path else ""
    return (
        f"inputs at lags {first} to {last}{boxed}, output at lags 1 to {spec.lags}, {layers}{path}"
    )


def initial_weights(spec: Spec, rng: np.random.Generator) -> FloatArray:
    """Return small random weights: variance 1/fan-in, biases spread over the tanh's range.

    A linear path begins at zero.
    """
    parts: list[FloatArray] = []
    for fan_in, fan_out in pairwise(spec.sizes):
        parts.append(rng.normal(size=fan_in * fan_out) / np.sqrt(fan_in))
        parts.append(rng.uniform(-0.7, 0.7, size=fan_out))
    if spec.linear_path:
        parts.append(np.zeros(spec.n_regressors))
    return np.concatenate(parts)


def layers(spec: Spec, weights: FloatArray) -> Layers:
    """Return (matrix, bias) of every layer as views into ``weights``."""
    result, at = Layers(), 0
    for fan_in, fan_out in pairwise(spec.sizes):
        matrix = weights[at : at + fan_in * fan_out].reshape(fan_out, fan_in)
        at += fan_in * fan_out
        result.append((matrix, weights[at : at + fan_out]))
        at += fan_out
    return result


def linear_path(spec: Spec, weights: FloatArray) -> FloatArray:
    """Return the weights (n_regressors,) of the linear path of a shape that has one."""
    return weights[-spec.n_regressors :]


def forward(spec: Spec, weights: Any, regressors: Any, tanh: Callable[[Any], Any] = np.tanh) -> Any:
    """Return the unclipped one-step predictions (n,) of ``regressors`` (n, n_regressors).

    weights, regressors : arrays, or tensors with their own ``tanh``
    """
    *inner, (matrix, bias) = layers(spec, weights)
    values = regressors
    for w, b in inner:
        values = tanh(values @ w.T + b)
    path = regressors @ linear_path(spec, weights) if spec.linear_path else 0.0
    return values @ matrix[0] + bias[0] + path


def widened(matrix: FloatArray, spec: Spec, common: Spec) -> FloatArray:
    """Return a matrix over the regressor of ``spec`` as one over that of a finer, longer shape."""
    k, wide = spec.n_inputs, np.zeros((len(matrix), common.n_regressors))
    for i, (first, stop) in enumerate(spec.boxes):
        for j, (a, b) in enumerate(common.boxes):
            if first <= a and b <= stop:
                own = matrix[:, i * k : (i + 1) * k]
                wide[:, j * k : (j + 1) * k] = own * (b - a) / (stop - first)
    start = k * len(common.boxes)
    wide[:, start : start + spec.lags] = matrix[:, k * len(spec.boxes) :]
    return wide


def input_regressors(spec: Spec, u: FloatArray) -> FloatArray:
    """Return the inputs' part of the regressor (n, n_boxes * n_inputs) of samples (n, n_inputs).

    Inputs before the first sample count as zero.
    """
    n, k = u.shape
    result = np.empty((n, len(spec.boxes), k))
    for i, (first, stop) in enumerate(spec.boxes):
        box = np.zeros((n, k))  # one piece of memory: six times as fast as adding to the result
        for lag in range(first, min(stop, n)):
            box[lag:] += u[: n - lag]
        result[:, i] = box / (stop - first)
    return result.reshape(n, -1)


def regressors(spec: Spec, u: FloatArray, y: FloatArray) -> FloatArray:
    """Return the series-parallel regressors (n - memory, n_regressors) of samples memory .. n - 1.

    u, y : shapes (n, n_inputs) and (n,), scaled
    """
    n, first = len(y), spec.memory
    outputs = [y[first - j : n - j, None] for j in range(1, spec.lags + 1)]
    return np.concatenate([input_regressors(spec, u)[first:], *outputs], axis=1)


def simulate(
    spec: Spec,
    weights: FloatArray,
    u: FloatArray,
    start: IntArray,
    stop: IntArray,
    history: FloatArray,
) -> FloatArray:
    """Return free-run predictions (n,), NaN outside the pieces start[i] .. stop[i] - 1.

    u : (n, n_inputs), scaled; every start must have ``memory`` samples before it
    history : (n_pieces, lags), the output before each start, newest first, scaled
    Raises ValueError if a piece begins before the memory.
    """
    if len(start) and (start.min() < spec.memory or stop.max() > len(u)):
        raise ValueError(f"pieces must lie within {spec.memory} .. {len(u)}")
    history = np.clip(history, spec.y_min, spec.y_max)
    x, limits, result = input_regressors(spec, u), (spec.y_min, spec.y_max), np.full(len(u), np.nan)
    shape = np.array(spec.sizes, dtype=np.int64)
    kernels.simulate(weights, shape, x, spec.lags, start, stop, history, *limits, result)
    return result
