"""Levenberg–Marquardt as the reference toolbox runs it, and ``Watch``, the record of any run.

Source: Hagan and Menhaj, Training feedforward networks with the Marquardt algorithm, IEEE TNN 5
(1994); the defaults are those of the reference toolbox (1,000 epochs, six validation failures,
minimum gradient 1e-7, mu 1e-3, x0.1, x10, at most 1e10).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from monitor.base.types import FloatArray

MU, MU_DOWN, MU_UP, MU_MAX = 1e-3, 0.1, 10.0, 1e10
MAX_FAIL = 6  # epochs in a row without a better validation score


class Objective(Protocol):
    """A sum of squares: its value, and the normal equations of its linearisation."""

    def cost(self, weights: FloatArray) -> float:
        """Return the mean squared error."""

    def normal(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the cost, J'J and J'e."""


@dataclass(slots=True)
class LmOutcome:
    """The result of a run of a minimiser."""

    weights: FloatArray  # best by validation, or the last ones without validation
    score: float  # validation score of these weights, or their cost
    stop: str  # why the run ended
    costs: list[float] = field(default_factory=list)  # after every epoch, first the initial one
    scores: list[float] = field(default_factory=list)


class Watch:
    """Keeps the best weights by validation, or by cost, and decides when a run ends and why.

    max_fail : accepted steps in a row without a better validation score, which end the run
    min_gradient : a shorter gradient ends the run
    validate : as in ``minimise``
    Raises ValueError if the cost at the start is not finite.
    """

    def __init__(
        self,
        weights: FloatArray,
        cost: float,
        max_fail: int = MAX_FAIL,
        validate: Callable[[FloatArray], float] | None = None,
        min_gradient: float = 1e-7,
    ) -> None:
        if not np.isfinite(cost):
            raise ValueError(f"the error is {cost} at the initial weights")
        score = validate(weights) if validate else cost
        self.outcome = LmOutcome(weights.copy(), score, "epochs", [cost], [score])
        self._max_fail, self._min_gradient, self._failures = max_fail, min_gradient, 0
        self._validate = validate

    def at_rest(self, gradient: FloatArray) -> bool:
        """Return whether the gradient is too short, and note it as the reason of the end."""
        return self._ends(float(np.linalg.norm(gradient)) < self._min_gradient, "gradient")

    def accept(self, weights: FloatArray, cost: float) -> bool:
        """Record an accepted step; return whether validation ends the run."""
        outcome = self.outcome
        score = self._validate(weights) if self._validate else cost
        outcome.costs.append(cost)
        outcome.scores.append(score)
        if score < outcome.score:
            outcome.weights, outcome.score, self._failures = weights.copy(), score, 0
            return False
        self._failures += 1
        failed = self._validate is not None and self._failures >= self._max_fail
        return self._ends(failed, "validation")

    def repeat(self) -> None:
        """Record an epoch whose step was taken back."""
        self.outcome.costs.append(self.outcome.costs[-1])
        self.outcome.scores.append(self.outcome.scores[-1])

    def _ends(self, ends: bool, stop: str) -> bool:
        if ends:
            self.outcome.stop = stop
        return ends


def minimise(
    objective: Objective,
    weights: FloatArray,
    validate: Callable[[FloatArray], float] | None = None,
    begins: Callable[[], bool] | None = None,
    *,
    epochs: int = 1000,
    max_fail: int = MAX_FAIL,
) -> LmOutcome:
    """Return the best weights that the method reaches from ``weights``; the cost never rises.

    validate : score of weights, lower is better; the weights with the best score are returned
    begins : counts an epoch; False ends the run, because the budget is used up
    Raises ValueError if the objective is not finite at the start.
    """
    current, mu = weights.copy(), MU
    cost = objective.cost(current)
    watch = Watch(current, cost, max_fail, validate)
    for _ in range(epochs):
        if begins is not None and not begins():
            watch.outcome.stop = "budget"
            break
        _, hessian, gradient = objective.normal(current)
        if watch.at_rest(gradient):
            break
        step = damped_step(objective, current, (cost, hessian, gradient), mu)
        if step is None:
            watch.outcome.stop = "mu"
            break
        current, cost, mu = step
        if watch.accept(current, cost):
            break
    return watch.outcome


def damped_step(
    objective: Objective,
    weights: FloatArray,
    normal: tuple[float, FloatArray, FloatArray],
    mu: float,
) -> tuple[FloatArray, float, float] | None:
    """Return weights, cost and mu after one step that lowers the cost, or None if none does.

    normal : the cost, J'J and J'e at ``weights``
    """
    (cost, hessian, gradient), diagonal = normal, np.arange(len(weights))
    while mu <= MU_MAX:
        damped = hessian.copy()
        damped[diagonal, diagonal] += mu
        try:
            factor = cho_factor(damped.T, lower=True, overwrite_a=True, check_finite=False)
            trial = weights - cho_solve(factor, gradient, check_finite=False)
        except LinAlgError:
            mu *= MU_UP
            continue
        trial_cost = objective.cost(trial)
        if trial_cost < cost:  # False for NaN
            return trial, trial_cost, max(mu * MU_DOWN, 1e-20)
        mu *= MU_UP
    return None
