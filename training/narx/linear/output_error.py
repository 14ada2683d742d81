"""Output error models: polynomials fitted to minimise the simulation error.

``y(t) = sum_i B_i(q) u_i(t) / F(q) + e(t)``: all inputs share the denominator F, as they share the
states in a state space model. The fit is Gauss-Newton with Levenberg's damping on gradients
filtered by 1/F. The free response of every stretch is projected out, so that no initial condition
is needed. A step that raises the error or makes the model unstable is refused.
Source: Ljung, System Identification, 2nd ed., sections 10.2 and 10.5; variable projection in
Kaufman's form, BIT 15 (1975) 49-57; the start is Steiglitz and McBride, IEEE TAC 10 (1965) 461-464.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from training.narx.linear.arx import Arx, fit_arx
from training.narx.linear.free_run import free_run_error
from training.narx.linear.regressors import Stretch

LARGEST_POLE = 0.9999
SEARCH_SAMPLES = 30_000  # training samples used to compare starts; the best is refined on all


@dataclass(frozen=True, slots=True)
class OutputError:
    """An output error model; ``transfer`` holds F (as ``a``), B, the dead times and the offset."""

    transfer: Arx

    @property
    def n_parameters(self) -> int:
        """The number of estimated coefficients."""
        return self.transfer.n_parameters

    @property
    def stable(self) -> bool:
        """Whether the free run forgets its start; true for every fitted model."""
        return self.transfer.stable

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        """Return the free run (n,); the initial state is fitted to the first outputs ``y0``."""
        start = min(self.transfer.lags, len(y0) - 1)
        forced, free = _responses(self.transfer, u, start)
        run = forced + free @ (
            _initial(free, len(y0) - start) @ (y0[start:] - forced[: len(y0) - start])
        )
        return np.concatenate([y0, run[len(y0) - start :]])

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step predictions (n,).

        They equal the simulation, because the model assumes white noise on the output.
        """
        return self.simulate(u, y[: min(len(y), 2 * self.transfer.lags)])


def _responses(model: Arx, u: FloatArray, start: int) -> tuple[FloatArray, FloatArray]:
    """Return the forced response (n - start,) and a basis (n - start, nf) of free responses.

    The basis is orthonormal.
    """
    n, order = len(u) - start, len(model.a)
    forced = lfilter([1.0], model.poly, model.drive(u)[start:])
    pulses = np.eye(n, order) + 1e-60  # avoids denormal numbers, with which the filter is slow
    free = lfilter([1.0], model.poly, pulses, axis=0)
    return forced, np.asarray(np.linalg.qr(free)[0])


def _initial(free: FloatArray, known: int) -> FloatArray:
    """Return the map (nf, known) from the first ``known`` errors to weights of the free responses.

    Directions with singular values below a tenth of the largest are left out.
    """
    return np.asarray(np.linalg.pinv(free[:known], rcond=0.1))


def _errors(
    model: Arx, stretch: Stretch, skip: int
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Return simulation errors (n - start,), free responses, the map of ``_initial``, and start."""
    u, y = stretch
    start = model.lags
    forced, free = _responses(model, u, start)
    first = _initial(free, skip - start)
    error = y[start:] - forced
    return error - free @ (first @ error[: skip - start]), free, first, start


def _linearised(
    model: Arx, records: Sequence[Stretch], skip: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the error (n - skip,) and the output's gradient (n - skip, n_parameters) per stretch.

    The parameters are f, the offset, b of the first input, b of the second ...
    """
    order, nb = len(model.a), model.b.shape[1]
    for u, y in records:
        error, free, first, start = _errors(model, (u, y), skip)
        known = skip - start
        output = np.concatenate([np.zeros(order), y[start:] - error])
        filtered = lfilter([1.0], model.poly, output)
        columns = [-sliding_window_view(filtered[:-1], order)[:, ::-1]] if order else []
        columns.append(lfilter([1.0], model.poly, np.ones((len(error), 1)), axis=0))
        for i, delay in enumerate(model.delays):
            signal = lfilter([1.0], model.poly, u[start - delay - nb + 1 : len(u) - delay, i])
            columns.append(sliding_window_view(signal, nb)[:, ::-1])
        gradient = np.concatenate(columns, axis=1)
        yield error[known:], gradient[known:] - free[known:] @ (first @ gradient[:known])


def _cost(model: Arx, records: Sequence[Stretch], skip: int) -> float:
    """Return the sum of squared free-run errors; the first ``skip`` samples do not count."""
    return sum(float(np.sum(_errors(model, r, skip)[0][skip - model.lags :] ** 2)) for r in records)


def stabilised(model: Arx) -> Arx:
    """Return the model with its unstable poles mirrored into the unit circle."""
    poles = np.roots(model.poly)
    size = np.abs(poles)
    mirrored = np.where(size > 1.0, poles / np.maximum(size, 1e-12) ** 2, poles)
    size = np.maximum(np.abs(mirrored), 1e-12)
    kept = mirrored * np.minimum(1.0, 0.999 * LARGEST_POLE / size)
    return (
        model
        if np.array_equal(kept, poles)
        else replace(model, a=np.asarray(np.poly(kept).real[1:], dtype=np.float64))
    )


def refine(
    start: Arx, records: Sequence[Stretch], skip: int, steps: int
) -> tuple[OutputError, float]:
    """Return the model after at most ``steps`` Gauss-Newton steps and its sum of squared errors."""
    model, damping = stabilised(start), 1e-3
    cost = _cost(model, records, skip)
    for _ in range(steps):
        size = model.n_parameters
        normal, slope = np.zeros((size, size)), np.zeros(size)
        for error, gradient in _linearised(model, records, skip):
            normal += gradient.T @ gradient
            slope += gradient.T @ error
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        normal /= np.outer(scale, scale)
        before = cost
        while damping < 1e6:
            step = np.linalg.solve(normal + damping * np.eye(size), slope / scale) / scale
            tried = _moved(model, step)
            lower = _cost(tried, records, skip) if _inside(tried) else float("inf")
            if lower < cost:
                model, cost, damping = tried, lower, max(damping / 10, 1e-9)
                break
            damping *= 10
        if cost > before * (1.0 - 1e-5):
            break
    return OutputError(model), cost


def _moved(model: Arx, step: FloatArray) -> Arx:
    order = len(model.a)
    b = model.b + step[order + 1 :].reshape(model.b.shape)
    return replace(model, a=model.a + step[:order], offset=model.offset + step[order], b=b)


def _inside(model: Arx) -> bool:
    return bool(np.all(np.abs(np.roots(model.poly)) < LARGEST_POLE))


def steiglitz_mcbride(
    start: Arx, records: Sequence[Stretch], skip: int, iterations: int = 8
) -> Arx:
    """Return a start for ``refine``, by the Steiglitz-McBride iteration from ``start``.

    Every iteration fits an ARX model on samples filtered by 1/A of the previous model and
    stabilises it. The model with the least simulation error is returned.
    """
    best, model = (_cost(stabilised(start), records, skip), stabilised(start)), stabilised(start)
    for _ in range(iterations):
        filtered = [
            (lfilter([1.0], model.poly, u, axis=0), lfilter([1.0], model.poly, y))
            for u, y in records
        ]
        fitted = fit_arx(filtered, len(model.a), model.b.shape[1], model.delays)
        gain = float(np.sum(model.poly))  # the column of ones was not filtered
        model = stabilised(replace(fitted, offset=fitted.offset * gain))
        best = min(best, (_cost(model, records, skip), model), key=lambda pair: pair[0])
    return best[1]


def thinned(records: Sequence[Stretch], samples: int = SEARCH_SAMPLES) -> list[Stretch]:
    """Return evenly spread pieces of 3,000 samples, about ``samples`` in total."""
    total = sum(len(y) for _, y in records)
    if total <= samples:
        return list(records)
    pieces = [
        (u[at : at + 3000], y[at : at + 3000])
        for u, y in records
        for at in range(0, len(y), 3000)
        if len(y) - at >= 1000
    ]
    return pieces[:: max(1, round(total / samples))]


def fit_output_error(
    train: Sequence[Stretch],
    validate: Sequence[Stretch],
    starts: Sequence[Arx],
    skip: int,
    steps: int = 15,
) -> tuple[OutputError, list[tuple[Arx, float, float]]]:
    """Return the output error model with the least free-run error on ``validate``, and all tries.

    starts : models of any order, improved by ``steiglitz_mcbride`` and then by ``refine``
    skip : number of first samples of a stretch that set the state and are not scored
    A try is the refined model of one start with its mean squared errors on ``train`` and
    ``validate``.
    """
    some = thinned(train)
    count = sum(len(y) - skip for _, y in some)
    tried = []
    for start in starts:
        first = steiglitz_mcbride(start, some, skip)
        model, cost = refine(first, some, skip, steps)
        tried.append((model.transfer, cost / count, free_run_error(model, validate, skip)))
    best = OutputError(min(tried, key=lambda entry: entry[2])[0])
    if len(some) < len(train) or count < sum(len(y) for _, y in train):
        full = refine(best.transfer, train, skip, steps)[0]
        best = min(best, full, key=lambda m: free_run_error(m, validate, skip))
    return best, tried
