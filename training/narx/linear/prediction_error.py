"""Models by their prediction error: output error, and state space in its innovations form.

``A(q) y(t) = offset + B(q) u(t) + C(q) e(t)``, all inputs with one A, as they share the states.
Levenberg–Marquardt minimises the mean square of e from an ARX model. An output error model keeps
C = A, so that e is its simulation error; in the innovations form C is free. Of the models on the
way the best stable one is kept.
Source: Ljung, System Identification, 2nd ed., sections 7.2, 10.2 and 10.5.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import minimise
from training.narx.linear.arx import Triangle, lagged
from training.narx.linear.models import LinearModel, Stretch


class PredictionError:
    """The mean squared one-step error of models with the orders and dead times of ``start``.

    The weights are offset, B, -A, and C if it is free.
    skip : number of first samples of a stretch that set the state and are not scored
    """

    def __init__(
        self, start: LinearModel, records: Sequence[Stretch], skip: int, *, output_error: bool
    ) -> None:
        self.lags, self.na, self.output_error = start.lags, len(start.a), output_error
        self.delays, self.size = start.delays, start.b.size + self.na + 1
        rows = [lagged(stretch, self.lags, self.lags) for stretch in records]
        tables = [Triangle(x, len(x), len(self.delays), self.lags, self.lags) for x in rows]
        shape = (self.na, start.b.shape[1], start.delays)
        self.rows = [table.factor[:, table.columns(*shape)] for table in tables]
        self.records, self.skip = records, skip

    def model(self, weights: FloatArray) -> LinearModel:
        """Return the model with these weights."""
        (offset,), b, a, c = np.split(weights, [1, self.size - self.na, self.size])
        b = b.reshape(len(self.delays), -1)
        return LinearModel(-a, b, self.delays, float(offset), -a if self.output_error else c)

    def cost(self, weights: FloatArray) -> float:
        """Return the mean squared error."""
        model = self.model(weights)
        scored = [model.errors(u, y)[self.skip :] for u, y in self.records]
        return float(np.mean(np.concatenate(scored) ** 2))

    def normal(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the cost, J'J and J'e, divided by the number of errors."""
        model, n, sums = self.model(weights), 0, np.zeros((len(weights) + 1,) * 2)
        for x, (u, y) in zip(self.rows, self.records, strict=True):
            error = model.errors(u, y)[self.lags :]
            past = [np.append(np.zeros(lag), error[:-lag]) for lag in range(1, self.na + 1)]
            slopes = np.column_stack([x, *past])
            if self.output_error:
                slopes[:, self.size - self.na : self.size] -= slopes[:, self.size :]
                slopes = slopes[:, : self.size]
            slopes = -lfilter([1.0], [1.0, *model.c], slopes, axis=0)
            rows = np.column_stack([slopes, error])[self.skip - self.lags :]
            sums, n = sums + rows.T @ rows, n + len(rows)
        return sums[-1, -1] / n, sums[:-1, :-1] / n, sums[:-1, -1] / n


def refine(
    start: LinearModel,
    records: Sequence[Stretch],
    skip: int,
    epochs: int = 30,
    *,
    output_error: bool = True,
) -> LinearModel:
    """Return the stable model with the least prediction error near ``start``.

    start : an ARX model with at least one ``a``; from an unstable one only B is taken
    skip : as of ``PredictionError``, at least the model's lags
    """
    loop = PredictionError(start, records, skip, output_error=output_error)
    a = start.a if start.stable else 0.0 * start.a
    first = np.concatenate([[start.offset], start.b.ravel(), -a, 0.0 * a[output_error * len(a) :]])

    def score(weights: FloatArray) -> float:
        return loop.cost(weights) if loop.model(weights).stable else np.inf

    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable trial
        found = minimise(loop, first, score, epochs=epochs, max_fail=epochs)
    return loop.model(found.weights)
