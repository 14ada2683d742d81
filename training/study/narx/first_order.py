"""First-order methods: gradient descent with momentum and adaptive rate, and scaled conjugate
gradient, which needs no line search.

Sources: Vogl et al., Accelerating the convergence of the back-propagation method, Biological
Cybernetics 59 (1988), with the step of the reference toolbox's documentation, ``momentum * previous
step - rate * momentum * gradient``; Moller, A scaled conjugate gradient algorithm for fast
supervised learning, Neural Networks 6 (1993), with its numbering of the steps. The defaults are
those of the reference toolbox, six validation failures among them.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOutcome, Watch
from training.narx.network import Spec, forward

Differentiable = Callable[[FloatArray], tuple[float, FloatArray]]  # of weights: cost and gradient

RATE: Final = 0.01
RATE_UP, RATE_DOWN = 1.05, 0.7  # after a step that lowered the cost, after one taken back
GROWTH = 1.04  # a step that raises the cost by more than this factor is taken back
MOMENTUM = 0.9
MIN_GRADIENT, MIN_CONJUGATE_GRADIENT = 1e-5, 1e-6
SIGMA = 5e-5  # length of the step that probes the curvature
DAMPING = 5e-7  # initial lambda
DAMPING_MAX = 1e30  # no direction descends any more
WORST = -1e3  # ratio of a step that raised the cost beyond all measure


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


def minimise_scaled_conjugate(
    objective: Differentiable,
    weights: FloatArray,
    epochs: int = 1000,
    validate: Callable[[FloatArray], float] | None = None,
) -> LmOutcome:
    """Return the best weights that scaled conjugate gradient reaches; the cost never rises.

    validate : as in ``lm.minimise``
    Raises ValueError if the objective is not finite at the start.
    """
    current = weights.copy()
    cost, gradient = objective(current)  # step 1
    watch = Watch(current, cost, validate=validate, min_gradient=MIN_CONJUGATE_GRADIENT)
    direction, damping, raised, curvature, moved = -gradient, DAMPING, 0.0, 0.0, True
    for epoch in range(1, epochs + 1):
        if watch.at_rest(gradient):
            break
        if damping > DAMPING_MAX:
            watch.outcome.stop = "damping"
            break
        length2 = float(direction @ direction)
        if moved:  # step 2
            probe = SIGMA / np.sqrt(length2)
            _, ahead = objective(current + probe * direction)
            curvature = float(direction @ (ahead - gradient)) / probe
        curvature += (damping - raised) * length2  # step 3
        if curvature <= 0.0:  # step 4 makes it positive
            raised = 2.0 * (damping - curvature / length2)
            curvature = damping * length2 - curvature
            damping = raised
        slope = -float(direction @ gradient)
        trial = current + (slope / curvature) * direction  # step 5
        trial_cost, trial_gradient = objective(trial)
        # step 6: actual over promised reduction
        ratio = 2.0 * curvature * (cost - trial_cost) / slope**2
        ratio = max(ratio, WORST) if np.isfinite(ratio) else WORST
        moved = ratio >= 0.0
        raised = 0.0 if moved else damping
        if moved:  # step 7
            before, current, cost, gradient = gradient, trial, trial_cost, trial_gradient
            direction = float(gradient @ (gradient - before)) / slope * direction - gradient
            if epoch % len(weights) == 0 or float(direction @ gradient) >= 0.0:
                direction = -gradient
            damping *= 0.25 if ratio >= 0.75 else 1.0
        if ratio < 0.25:  # step 8
            damping += curvature * (1.0 - ratio) / length2
        if not moved:
            watch.repeat()
        elif watch.accept(current, cost):
            break
    return watch.outcome
