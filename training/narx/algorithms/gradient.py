"""Gradient descent with momentum and adaptive rate.

Source: Vogl et al., Accelerating the convergence of the back-propagation method, Biological
Cybernetics 59 (1988); the step is that of the reference toolbox's documentation, ``momentum *
previous step - rate * momentum * gradient``, and so are the defaults (rate 0.01, x1.05, x0.7,
growth limit 1.04, momentum 0.9, minimum gradient 1e-5, six validation failures).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOutcome, Watch
from training.narx.work import Meter


class Differentiable(Protocol):
    """A function of the weights with its gradient."""

    def cost(self, weights: FloatArray) -> float:
        """Return the mean squared error."""

    def gradient(self, weights: FloatArray) -> tuple[float, FloatArray]:
        """Return the cost and its gradient (n_weights,)."""


@dataclass(frozen=True, slots=True)
class GradientOptions:
    """Settings of the descent."""

    epochs: int = 1000
    max_fail: int = 6  # accepted steps in a row in which the validation score does not improve
    min_gradient: float = 1e-5
    rate: float = 0.01
    rate_up: float = 1.05  # after a step that lowered the cost
    rate_down: float = 0.7  # after a step that was taken back
    growth: float = 1.04  # a step that raises the cost by more than this factor is taken back
    momentum: float = 0.9


def descend(
    objective: Differentiable,
    weights: FloatArray,
    options: GradientOptions | None = None,
    validate: Callable[[FloatArray], float] | None = None,
    meter: Meter | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> LmOutcome:
    """Return the best weights that gradient descent with momentum reaches from ``weights``.

    validate, meter, progress : as in ``lm.minimise``
    Raises ValueError if the objective is not finite at the start.
    """
    options = options or GradientOptions()
    current, rate = weights.copy(), options.rate
    cost, gradient = objective.gradient(current)
    watch = Watch(
        weights=current,
        cost=cost,
        max_fail=options.max_fail,
        min_gradient=options.min_gradient,
        validate=validate,
        meter=meter,
        progress=progress,
    )
    step = -rate * gradient
    for _ in range(options.epochs):
        if watch.over_budget() or watch.at_rest(gradient):
            break
        step = options.momentum * step - rate * options.momentum * gradient
        trial = current + step
        trial_cost, trial_gradient = objective.gradient(trial)
        if not trial_cost <= options.growth * cost:  # True for NaN
            rate *= options.rate_down
            step = -rate * gradient
            watch.repeat()
            continue
        rate *= options.rate_up if trial_cost < cost else 1.0
        current, cost, gradient = trial, trial_cost, trial_gradient
        if watch.accept(current, cost):
            break
    return watch.outcome
