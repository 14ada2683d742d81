"""Scaled conjugate gradient: conjugate directions without a line search.

Source: Moller, A scaled conjugate gradient algorithm for fast supervised learning, Neural Networks
6 (1993), with its numbering of the steps; the defaults are those of the reference toolbox
(sigma 5e-5, lambda 5e-7, minimum gradient 1e-6, six validation failures).
"""

from collections.abc import Callable

import numpy as np

from monitor.base.types import FloatArray
from training.narx.algorithms.gradient import Differentiable
from training.narx.algorithms.lm import LmOutcome, Watch

MAX_FAIL, MIN_GRADIENT = 6, 1e-6
SIGMA = 5e-5  # length of the step that probes the curvature
DAMPING = 5e-7  # initial lambda
DAMPING_MAX = 1e30  # no direction descends any more
WORST = -1e3  # ratio of a step that raised the cost beyond all measure


def minimise_scaled_conjugate(
    objective: Differentiable,
    weights: FloatArray,
    epochs: int = 1000,
    validate: Callable[[FloatArray], float] | None = None,
) -> LmOutcome:
    """Return the best weights that the method reaches from ``weights``; the cost never rises.

    validate : as in ``lm.minimise``
    Raises ValueError if the objective is not finite at the start.
    """
    search = _Search(objective, weights)
    watch = Watch(search.weights, search.cost, MAX_FAIL, MIN_GRADIENT, validate)
    for epoch in range(epochs):
        if watch.at_rest(search.gradient):
            break
        if search.damping > DAMPING_MAX:
            watch.outcome.stop = "damping"
            break
        if not search.step(restart=(epoch + 1) % len(weights) == 0):
            watch.repeat()
        elif watch.accept(search.weights, search.cost):
            break
    return watch.outcome


class _Search:
    """The state of the search: weights, direction and damping of the curvature."""

    def __init__(self, objective: Differentiable, weights: FloatArray) -> None:
        self.objective = objective
        self.weights = weights.copy()
        self.cost, self.gradient = objective.gradient(self.weights)  # step 1
        self.direction = -self.gradient
        self.damping, self._raised = DAMPING, 0.0
        self._curvature, self._moved = 0.0, True

    def step(self, restart: bool) -> bool:
        """Try one step and return whether it was taken.

        restart : the next direction is that of steepest descent
        """
        length2 = float(self.direction @ self.direction)
        self._update_curvature(length2)
        slope = -float(self.direction @ self.gradient)
        trial = self.weights + (slope / self._curvature) * self.direction  # step 5
        trial_cost = self.objective.cost(trial)
        # step 6: actual over promised reduction
        ratio = 2.0 * self._curvature * (self.cost - trial_cost) / slope**2
        ratio = max(ratio, WORST) if np.isfinite(ratio) else WORST
        self._moved = ratio >= 0.0
        if self._moved:  # step 7
            before, self.weights = self.gradient, trial
            self.cost, self.gradient = self.objective.gradient(trial)
            conjugate = float(self.gradient @ (self.gradient - before)) / slope
            self.direction = conjugate * self.direction - self.gradient
            if restart or float(self.direction @ self.gradient) >= 0.0:
                self.direction = -self.gradient
            self.damping *= 0.25 if ratio >= 0.75 else 1.0
        self._raised = 0.0 if self._moved else self.damping
        if ratio < 0.25:  # step 8
            self.damping += self._curvature * (1.0 - ratio) / length2
        return self._moved

    def _update_curvature(self, length2: float) -> None:
        """Find the damped curvature along the direction and make it positive, steps 2 to 4."""
        if self._moved:
            probe = SIGMA / np.sqrt(length2)
            _, ahead = self.objective.gradient(self.weights + probe * self.direction)
            self._curvature = float(self.direction @ (ahead - self.gradient)) / probe
        self._curvature += (self.damping - self._raised) * length2
        if self._curvature <= 0.0:
            self._raised = 2.0 * (self.damping - self._curvature / length2)
            self._curvature = self.damping * length2 - self._curvature
            self.damping = self._raised
