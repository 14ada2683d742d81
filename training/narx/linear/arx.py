"""ARX models: least squares over a grid of orders, order criteria, dead times, free run.

``y(t) + a1 y(t-1) + .. = offset + sum_i (b_i0 u_i(t-nk_i) + b_i1 u_i(t-nk_i-1) + ..) + e(t)``
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np

from monitor.base.types import FloatArray
from training.narx.linear.models import LinearModel, free_run_error
from training.narx.linear.regressors import Stretch, Triangle

MAX_ORDER = 20
MAX_DELAY = 20  # samples
GRID_DELAYS = 10  # largest dead time of the grid, in samples, common to all inputs
FREE_RUN_ORDERS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 30, 40)
FREE_RUN_DELAYS = 4  # largest dead time, in samples, of the search by free run

Delays = tuple[int, ...]  # (k,) dead time of every input, samples


def solve_arx(data: Triangle, na: int, nb: int, delays: Delays) -> LinearModel:
    """Return the least-squares ARX model from condensed samples with at least its lags."""
    return _arx(data.solve(data.columns(na, nb, delays)), nb, delays)


def _arx(theta: FloatArray, nb: int, delays: Delays) -> LinearModel:
    (offset,), b, a = np.split(theta, [1, 1 + nb * len(delays)])
    return LinearModel(-a, b.reshape(-1, nb), delays, float(offset))


@dataclass(frozen=True, slots=True)
class ArxCandidate:
    """An ARX model of one combination of orders and dead times, with its criteria."""

    model: LinearModel
    validation_loss: float  # mean squared one-step error
    aic: float
    mdl: float


def order_grid(
    train: Triangle, validate: Triangle, max_order: int, delays: Sequence[Delays]
) -> list[ArxCandidate]:
    """Return the candidates of all orders up to ``max_order`` for all choices of dead times.

    AIC = log V + 2 d / N and MDL = V (1 + d log N / N), with loss V, d parameters and N samples.
    Source: the order selection of the reference toolbox.
    """
    orders, found = range(1, max_order + 1), []
    for na, nb, choice in product(orders, orders, delays):
        columns = train.columns(na, nb, choice)
        theta = train.solve(columns)
        losses = [
            float(np.sum((each.factor[:, 1] - each.factor[:, columns] @ theta) ** 2)) / each.rows
            for each in (train, validate)
        ]
        v, n, d = max(losses[0], 1e-15), train.rows, len(columns)
        aic, mdl = float(np.log(v)) + 2 * d / n, v * float(1 + d * np.log(n) / n)
        found.append(ArxCandidate(_arx(theta, nb, choice), losses[1], aic, mdl))
    return found


def arx_delays(data: Triangle, max_delay: int = MAX_DELAY) -> Delays:
    """Return the dead time of every input, (k,) samples, 0 to ``max_delay``.

    The dead times minimise the loss of an ARX model of order 2. With several inputs the search
    starts from the best common dead time and improves one input after the other until nothing
    changes. Source: the delay estimation of the reference toolbox.
    """
    span = range(min(max_delay, data.u_lags - 1) + 1)

    def loss(delays: Delays) -> float:
        return float(np.sum(data.left(data.columns(2, 2, delays)) ** 2))

    best, before = min(((d,) * data.n_inputs for d in span), key=loss), Delays()
    while best != before:
        before = best
        for i in range(data.n_inputs):
            best = min(((*best[:i], d, *best[i + 1 :]) for d in span), key=loss)
    return best


def common_delays(n_inputs: int, largest: int, other: Delays) -> list[Delays]:
    """Return dead times 0 .. ``largest`` common to all inputs, then ``other`` without repeats."""
    return list(dict.fromkeys([*((d,) * n_inputs for d in range(largest + 1)), other]))


def best_in_free_run(
    data: Triangle, validate: Sequence[Stretch], max_order: int, delays: Delays
) -> LinearModel:
    """Return the ARX model with the least free-run error on ``validate``.

    data : condensed training samples
    delays : tried beside dead times that are common to all inputs
    The search goes over na up to ``max_order`` and nb up to twice that: first a coarse grid (na = 0
    is the impulse response model and always stable), then the neighbours of the best model until
    none is better.
    """
    skip = max(data.y_lags, data.u_lags)

    @cache
    def fitted(na: int, nb: int, choice: Delays) -> tuple[float, LinearModel]:
        model = solve_arx(data, na, nb, choice)
        return free_run_error(model, validate, skip), model

    def best(keys: Iterable[tuple[int, int, Delays]]) -> tuple[int, int, Delays]:
        longest = {d: min(2 * max_order, data.u_lags + 1 - max(d)) for d in choices}
        possible = (k for k in keys if 0 <= k[0] <= max_order and 1 <= k[1] <= longest[k[2]])
        return min(possible, key=lambda key: fitted(*key)[0])

    choices = common_delays(data.n_inputs, min(FREE_RUN_DELAYS, max_order), delays)
    before, found = None, best(product(FREE_RUN_ORDERS, FREE_RUN_ORDERS, choices))
    while found != before:
        before, (na, nb, choice) = found, found
        near = [(na + i, nb + j, choice) for i, j in product((0, -1, 1), repeat=2)]
        found = best(near)
    return fitted(*found)[1]
