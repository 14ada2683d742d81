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

MIN_GRADIENT = 1e-6
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
    current = weights.copy()
    cost, gradient = objective(current)  # step 1
    watch = Watch(current, cost, validate=validate, min_gradient=MIN_GRADIENT)
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
