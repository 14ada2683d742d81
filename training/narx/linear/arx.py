"""ARX models: least squares over a grid of orders, order criteria, dead times, free run.

``y(t) + a1 y(t-1) + .. = offset + sum_i (b_i0 u_i(t-nk_i) + b_i1 u_i(t-nk_i-1) + ..) + e(t)``

No regressor reaches across the end of a stretch. The rows of all stretches
``[1, y(t) .. y(t-Ly), u1(t) .. u1(t-Lu), u2(t) ..]`` are condensed into their triangular factor R.
Least squares on any columns of R gives the same result as on all samples, but R has only as many
rows as columns.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from training.narx.linear.models import LinearModel, Stretch, free_run_error

CHUNK = 4000  # rows condensed at a time
MAX_ORDER = 20
MAX_DELAY = 20  # samples
GRID_DELAYS = 10  # largest dead time of the grid, in samples, common to all inputs
FREE_RUN_ORDERS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 30, 40)
FREE_RUN_DELAYS = 4  # largest dead time, in samples, of the search by free run

Delays = tuple[int, ...]  # (k,) dead time of every input, samples


def largest_order(stretches: Sequence[Stretch]) -> int:
    """Return the largest model order for the data, at most ``MAX_ORDER``.

    The data need ten samples per parameter, and half of the stretches eight times the order.
    Raises RecordingError if the order would be below 2.
    """
    lengths = np.array([len(y) for _, y in stretches])
    signals = stretches[0][0].shape[1] + 1
    order = int(min(MAX_ORDER, lengths.sum() // (10 * signals), np.median(lengths) // 8))
    if order < 2:
        raise RecordingError(
            f"{lengths.sum()} samples in {len(lengths)} stretches are too few for linear models "
            f"with {signals - 1} inputs, at least {max(20 * signals, 16)} in one are wanted"
        )
    return order


@dataclass(frozen=True, slots=True)
class Triangle:
    """The factor R (m, m) of all lagged regressors; its Gram matrix is R.T @ R."""

    factor: FloatArray  # or the rows themselves
    rows: int  # number of condensed samples
    n_inputs: int
    y_lags: int
    u_lags: int

    def columns(self, na: int, nb: int, delays: Sequence[int]) -> list[int]:
        """Return the numbers of the columns 1, u1(t - delay) .., u2(t - delay) .., y(t-1) .."""
        width = self.u_lags + 1
        first = [2 + self.y_lags + i * width + delay for i, delay in enumerate(delays)]
        return [0, *(at + tap for at in first for tap in range(nb)), *range(2, 2 + na)]

    def solve(self, columns: Sequence[int]) -> FloatArray:
        """Return the least-squares coefficients (n_columns,) of y(t) on these columns."""
        left = self.factor[:, columns]
        scale = np.linalg.norm(left, axis=0)
        scale[scale == 0.0] = 1.0
        return np.asarray(np.linalg.lstsq(left / scale, self.factor[:, 1], rcond=1e-10)[0] / scale)

    def left(self, columns: Sequence[int]) -> FloatArray:
        """Return what these columns leave of y(t), a vector (m,) of the same norm."""
        return self.factor[:, 1] - self.factor[:, columns] @ self.solve(columns)

    def standard_errors(self, columns: Sequence[int]) -> FloatArray:
        """Return those of the coefficients (n_columns,), if what is left is white."""
        variance = float(np.sum(self.left(columns) ** 2)) / max(self.rows - len(columns), 1)
        inverse = np.linalg.pinv(self.factor[:, columns], rcond=1e-10)
        return np.sqrt(variance * np.sum(inverse**2, axis=1))


def lagged(stretch: Stretch, y_lags: int, u_lags: int) -> FloatArray:
    """Return the rows (n - longest lag, 2 + y_lags + k (u_lags + 1)) with full history."""
    u, y = stretch
    longest = max(y_lags, u_lags)

    def windows(signal: FloatArray, lags: int) -> FloatArray:
        return sliding_window_view(signal[longest - lags :], lags + 1)[:, ::-1]

    one = np.ones((len(y) - longest, 1))
    return np.concatenate([one, windows(y, y_lags), *(windows(x, u_lags) for x in u.T)], axis=1)


def triangle(stretches: Sequence[Stretch], y_lags: int, u_lags: int) -> Triangle:
    """Return the condensed stretches; a stretch shorter than its lags is left out.

    Raises RecordingError if there are too few samples.
    Source: sequential QR, Golub and Van Loan, Matrix Computations, section 5.3.
    """
    n_inputs = stretches[0][0].shape[1]
    width = 2 + y_lags + n_inputs * (u_lags + 1)
    factor, rows = np.zeros((0, width)), 0
    for stretch in (s for s in stretches if len(s[1]) > max(y_lags, u_lags)):
        every = lagged(stretch, y_lags, u_lags)
        for start in range(0, len(every), CHUNK):
            chunk = every[start : start + CHUNK]
            factor = np.asarray(np.linalg.qr(np.vstack([factor, chunk]), mode="r"))
        rows += len(every)
    if rows <= width // 2:
        raise RecordingError(f"{rows} samples with full history for {width} lagged signals")
    return Triangle(factor, rows, n_inputs, y_lags, u_lags)


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
