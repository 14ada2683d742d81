"""Gradient descent with momentum and adaptive rate.

Source: Vogl et al., Accelerating the convergence of the back-propagation method, Biological
Cybernetics 59 (1988); the step is that of the reference toolbox's documentation, ``momentum *
previous step - rate * momentum * gradient``, and so are the defaults (rate 0.01, x1.05, x0.7,
growth limit 1.04, momentum 0.9, minimum gradient 1e-5, six validation failures).
"""

from collections.abc import Callable
from typing import Any, Final

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOutcome, Watch
from training.narx.network import Spec, forward

Differentiable = Callable[[FloatArray], tuple[float, FloatArray]]  # of weights: cost and gradient

RATE: Final = 0.01
RATE_UP, RATE_DOWN = 1.05, 0.7  # after a step that lowered the cost, after one taken back
GROWTH = 1.04  # a step that raises the cost by more than this factor is taken back
MOMENTUM = 0.9
MIN_GRADIENT = 1e-5


def one_step_by_torch(
    spec: Spec, regressors: FloatArray, target: FloatArray, weight: FloatArray
) -> Differentiable:
    """Return the weighted mean squared one-step error with its gradient by torch.

    regressors, target, weight : shapes (n, n_regressors), (n,), (n,)
    """
    import torch  # noqa: PLC0415  # takes seconds

    torch.set_num_threads(1)  # trainings run side by side, and sums have one order
    x, y, w = (torch.from_numpy(each) for each in (regressors, target, weight))

    def error(weights: Any) -> Any:
        return w @ (forward(spec, weights, x, torch.tanh) - y) ** 2 / w.sum()

    def objective(weights: FloatArray) -> tuple[float, FloatArray]:
        gradient, cost = torch.func.grad_and_value(error)(torch.from_numpy(weights))
        return float(cost), gradient.numpy()

    return objective


def descend(
    objective: Differentiable,
    weights: FloatArray,
    epochs: int = 1000,
    rate: float = RATE,
    validate: Callable[[FloatArray], float] | None = None,
) -> LmOutcome:
    """Return the best weights that gradient descent with momentum reaches from ``weights``.

    validate : as in ``lm.minimise``
    Raises ValueError if the objective is not finite at the start.
    """
    current = weights.copy()
    cost, gradient = objective(current)
    watch = Watch(current, cost, validate=validate, min_gradient=MIN_GRADIENT)
    step = -rate * gradient
    for _ in range(epochs):
        if watch.at_rest(gradient):
            break
        step = MOMENTUM * (step - rate * gradient)
        trial = current + step
        trial_cost, trial_gradient = objective(trial)
        if not trial_cost <= GROWTH * cost:  # True for NaN
            rate *= RATE_DOWN
            step = -rate * gradient
            watch.repeat()
            continue
        rate *= RATE_UP if trial_cost < cost else 1.0
        current, cost, gradient = trial, trial_cost, trial_gradient
        if watch.accept(current, cost):
            break
    return watch.outcome
