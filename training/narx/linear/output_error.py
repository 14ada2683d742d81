"""Output error models: polynomials fitted to minimise the simulation error.

``y(t) = sum_i B_i(q) u_i(t) / F(q) + e(t)``: all inputs share the denominator F, as they share the
states in a state space model. Such a model is a NARX without hidden layers whose output feeds back,
so that Levenberg–Marquardt in closed loop fits it. Of the models on its way the best stable one is
kept.
Source: Ljung, System Identification, 2nd ed., sections 10.2 and 10.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOptions, minimise
from training.narx.algorithms.objectives import ClosedLoop, Pieces, measured_history
from training.narx.linear.arx import Arx
from training.narx.linear.free_run import free_run_error
from training.narx.linear.regressors import Stretch
from training.narx.network import Spec
from training.recordings.samples.preparation import Samples


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
        """Return the free run (n,); it begins as early in the first outputs ``y0`` as it can."""
        run = self.transfer.simulate(u, y0[: self.transfer.lags])
        run[: len(y0)] = y0
        return run

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Return the one-step predictions (n,).

        They equal the simulation, because the model assumes white noise on the output.
        """
        return self.simulate(u, y[: self.transfer.lags])


def refine(
    start: Arx, records: Sequence[Stretch], skip: int, epochs: int
) -> tuple[OutputError, float]:
    """Return the stable model with the least simulation error near ``start``, and its mean square.

    start : at least one ``a``; from an unstable one only B is taken
    skip : number of first samples of a stretch that set the state and are not scored
    """
    order, (k, nb), first = len(start.a), start.b.shape, start.lags
    spec = Spec(k, order, (), 0, input_boxes=tuple((lag, lag + 1) for lag in range(nb)))
    late = [  # each input by its dead time; rows before ``first`` are not used
        np.column_stack([np.roll(u[:, i], delay) for i, delay in enumerate(start.delays)])
        for u, _ in records
    ]
    y = np.concatenate([each for _, each in records])
    sizes = np.array([len(each) for _, each in records], dtype=np.int64)
    samples, stop = Samples(np.concatenate(late), y, np.ones(len(y))), np.cumsum(sizes)
    begin = stop - sizes + first
    history = measured_history(samples, order, begin)
    loop = ClosedLoop(
        spec, samples, Pieces(begin, stop, np.full_like(begin, skip - first), history), np.float64
    )

    def model(weights: FloatArray) -> OutputError:
        b, a, offset = np.split(weights, [k * nb, k * nb + order])
        return OutputError(
            replace(start, a=-a, b=b.reshape(nb, k).T.copy(), offset=float(offset[0]))
        )

    a = start.a if start.stable else np.zeros(order)
    found = minimise(
        loop,
        np.concatenate([start.b.T.ravel(), -a, [start.offset]]),
        LmOptions(epochs=epochs, max_fail=epochs),
        lambda weights: loop.cost(weights) if model(weights).stable else np.inf,
    )
    return model(found.weights), found.score


def fit_output_error(
    train: Sequence[Stretch],
    validate: Sequence[Stretch],
    starts: Sequence[Arx],
    skip: int,
    epochs: int = 30,
) -> tuple[OutputError, list[tuple[Arx, float, float]]]:
    """Return the output error model with the least free-run error on ``validate``, and all tries.

    starts : models of any order, each with at least one ``a``
    skip : number of first samples of a stretch that set the state and are not scored
    A try is the refined model of one start with its mean squared errors on ``train`` and
    ``validate``.
    """
    tried = []
    for start in starts:
        model, error = refine(start, train, skip, epochs)
        tried.append((model.transfer, error, free_run_error(model, validate, skip)))
    return OutputError(min(tried, key=lambda entry: entry[2])[0]), tried
