"""ARX models: least squares over a grid of orders, order criteria, dead times, free run.

``y(t) + a1 y(t-1) + .. = offset + sum_i (b_i0 u_i(t-nk_i) + b_i1 u_i(t-nk_i-1) + ..) + e(t)``
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from training.narx.linear.models import LinearModel, free_run_error
from training.narx.linear.regressors import Stretch, Triangle

MAX_ORDER = 20
MAX_DELAY = 20  # samples
GRID_DELAYS = 10  # largest dead time of the grid, in samples, common to all inputs
FREE_RUN_ORDERS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 30, 40)
FREE_RUN_DELAYS = 4  # largest dead time, in samples, of the search by free run


def solve_arx(data: Triangle, na: int, nb: int, delays: Sequence[int]) -> LinearModel:
    """Return the least-squares ARX model from condensed samples with at least its lags."""
    theta = data.solve(_columns(data, na, nb, delays))
    n_b = nb * data.n_inputs
    b = theta[1 : 1 + n_b].reshape(data.n_inputs, nb)
    return LinearModel(-theta[1 + n_b :], b, tuple(delays), float(theta[0]))


def _columns(data: Triangle, na: int, nb: int, delays: Sequence[int]) -> list[int]:
    taps = [data.u_at(i, *range(d, d + nb)) for i, d in enumerate(delays)]
    return [0, *(c for tap in taps for c in tap), *data.y_at(*range(1, na + 1))]


@dataclass(frozen=True, slots=True)
class ArxCandidate:
    """One combination of orders and dead times with its criteria."""

    na: int
    nb: int
    delays: tuple[int, ...]
    n_parameters: int
    validation_loss: float  # mean squared one-step error
    aic: float
    mdl: float


def order_grid(
    train: Triangle, validate: Triangle, max_order: int, delays: Sequence[tuple[int, ...]]
) -> list[ArxCandidate]:
    """Return the candidates of all orders up to ``max_order`` for all choices of dead times.

    delays : choices of dead times, (k,) samples each
    One Cholesky factor of the Gram matrix per nb and dead times gives all na.
    AIC = log V + 2 d / N and MDL = V (1 + d log N / N), with loss V, d parameters and N samples.
    Source: the order selection of the reference toolbox.
    """
    gram, n = train.factor.T @ train.factor, train.rows
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram /= np.outer(scale, scale)
    held_out = validate.factor / scale
    found = []
    for choice, nb in product(delays, range(1, max_order + 1)):
        columns = _columns(train, max_order, nb, choice)
        every = [*columns, 1]
        block = gram[np.ix_(every, every)] + 1e-12 * np.eye(len(every))
        lower = cholesky(block, lower=True)
        fixed, row = len(columns) - max_order, lower[-1, :-1]
        explained = np.concatenate([[0.0], np.cumsum(row**2)])
        for na in range(1, max_order + 1):
            d = fixed + na
            theta = solve_triangular(lower[:d, :d], row[:d], lower=True, trans=1)
            error = held_out[:, 1] - held_out[:, columns[:d]] @ theta
            loss = max(1.0 - float(explained[d]), 1e-15) * scale[1] ** 2 / n
            held_out_loss = float(error @ error) * scale[1] ** 2 / validate.rows
            aic, mdl = np.log(loss) + 2 * d / n, loss * (1 + d * np.log(n) / n)
            criteria = {"validation_loss": held_out_loss, "aic": float(aic), "mdl": float(mdl)}
            found.append(ArxCandidate(na, nb, choice, n_parameters=d, **criteria))
    return found


def arx_delays(data: Triangle, max_delay: int = MAX_DELAY) -> tuple[int, ...]:
    """Return the dead time of every input, (k,) samples, 0 to ``max_delay``.

    The dead times minimise the loss of an ARX model of order 2. With several inputs the search
    starts from the best common dead time and improves one input after the other until nothing
    changes. Source: the delay estimation of the reference toolbox.
    """
    largest = min(max_delay, data.u_lags - 1)

    def loss(delays: tuple[int, ...]) -> float:
        columns = _columns(data, 2, 2, delays)
        error = data.factor[:, 1] - data.factor[:, columns] @ data.solve(columns)
        return float(error @ error)

    span = range(largest + 1)
    best = min(((d,) * data.n_inputs for d in span), key=loss)
    for _ in range(5):
        before = best
        for i in range(data.n_inputs):
            best = min(((*best[:i], d, *best[i + 1 :]) for d in span), key=loss)
        if best == before:
            break
    return best


def common_delays(n_inputs: int, largest: int, *others: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return dead times 0 .. ``largest`` common to all inputs, then ``others`` without repeats."""
    choices = [(d,) * n_inputs for d in range(largest + 1)]
    return choices + [other for other in others if other not in choices]


def best_in_free_run(
    data: Triangle, validate: Sequence[Stretch], max_order: int, delays: tuple[int, ...]
) -> LinearModel:
    """Return the ARX model with the least free-run error on ``validate``.

    data : condensed training samples
    delays : (k,) samples, tried beside dead times that are common to all inputs
    The search goes over na up to ``max_order`` and nb up to twice that: first a coarse grid (na = 0
    is the impulse response model and always stable), then the neighbours of the best model until
    none is better.
    """
    skip = max(data.y_lags, data.u_lags)

    @cache
    def fitted(key: tuple[int, int, tuple[int, ...]]) -> tuple[float, LinearModel]:
        model = solve_arx(data, *key)
        return free_run_error(model, validate, skip), model

    def score(key: tuple[int, int, tuple[int, ...]]) -> float:
        return fitted(key)[0]

    def possible(na: int, nb: int, choice: tuple[int, ...]) -> bool:
        longest = min(2 * max_order, data.u_lags + 1 - max(choice))
        return 0 <= na <= max_order and 1 <= nb <= longest

    choices = common_delays(data.n_inputs, min(FREE_RUN_DELAYS, max_order), delays)
    grid = product(FREE_RUN_ORDERS, FREE_RUN_ORDERS, choices)
    best = min((k for k in grid if possible(*k)), key=score)
    while True:
        na, nb, choice = best
        near = [(na + i, nb + j, choice) for i, j in product((-1, 0, 1), repeat=2)]
        better = min((k for k in near if possible(*k)), key=score)
        if score(better) >= score(best):
            return fitted(best)[1]
        best = better
