"""Output error models: polynomials fitted to minimise the simulation error.

``y(t) = sum_i B_i(q) u_i(t) / F(q) + e(t)``: all inputs share the denominator F, as they share the
states in a state space model. Such a model is a NARX without hidden layers whose output feeds back,
so that Levenberg–Marquardt in closed loop fits it. Of the models on its way the best stable one is
kept.
Source: Ljung, System Identification, 2nd ed., sections 10.2 and 10.5.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import minimise
from training.narx.algorithms.objectives import ClosedLoop, Pieces, measured_history
from training.narx.linear.models import LinearModel
from training.narx.linear.regressors import Stretch
from training.narx.network import Spec
from training.recordings.samples.preparation import Samples


def refine(
    start: LinearModel, records: Sequence[Stretch], skip: int, epochs: int = 30
) -> tuple[LinearModel, float]:
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

    def model(weights: FloatArray) -> LinearModel:
        b, a, offset = np.split(weights, [k * nb, k * nb + order])
        b = b.reshape(nb, k).T.copy()
        return replace(start, a=-a, b=b, offset=float(offset[0]), c=-a)

    a = start.a if start.stable else np.zeros(order)
    found = minimise(
        loop,
        np.concatenate([start.b.T.ravel(), -a, [start.offset]]),
        lambda weights: loop.cost(weights) if model(weights).stable else np.inf,
        epochs=epochs,
        max_fail=epochs,
    )
    return model(found.weights), found.score
