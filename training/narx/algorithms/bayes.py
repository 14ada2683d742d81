"""Bayesian regularisation: Levenberg–Marquardt on the error and the weights, balanced by evidence.

The objective is beta * E_D + alpha * E_W, with E_D the sum of squared errors and E_W the sum of
squared weights. After every step alpha and beta follow from gamma, the effective number of
parameters. So the training needs no validation set, and none stops it.

Source: MacKay, Bayesian interpolation, Neural Computation 4 (1992); Foresee and Hagan,
Gauss-Newton approximation to Bayesian learning, ICNN (1997); defaults of the reference toolbox
(1,000 epochs, mu 0.005, x0.1, x10, at most 1e10, minimum gradient 1e-7).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.lapack import dtrtri

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOptions, LmOutcome, Objective, Watch
from training.narx.work import Meter

DEFAULTS = LmOptions(mu=0.005)


@dataclass(slots=True)
class BayesOutcome(LmOutcome):
    """An outcome with its final hyperparameters."""

    alpha: float = 0.0  # inverse prior variance of the weights, over two
    beta: float = 0.0  # inverse noise variance, over two
    effective_weights: float = 0.0  # gamma, at most the number of weights


@dataclass(slots=True)
class _State:
    """The state of the search; errors are sums over all samples."""

    weights: FloatArray
    squared_error: float
    alpha: float
    beta: float
    gamma: float
    mu: float

    @property
    def cost(self) -> float:
        return self.beta * self.squared_error + self.alpha * float(self.weights @ self.weights)


def minimise_bayesian(
    objective: Objective,
    weights: FloatArray,
    n_samples: int,
    options: LmOptions = DEFAULTS,
    meter: Meter | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> BayesOutcome:
    """Return the last weights, on which the evidence settles.

    objective : mean over samples, so that ``n_samples`` times its cost is the sum of squares
    meter : counts the epochs and ends the run when the budget is used up
    progress : called with the epoch and the mean squared error after every epoch
    Raises ValueError if the objective is not finite at the start.
    """
    cost = objective.cost(weights)
    watch = Watch(
        weights,
        cost,
        options.max_fail,
        options.min_gradient,
        meter=meter,
        progress=progress,
    )
    # Foresee and Hagan begin with alpha 0 and beta 1; the first step sets both right.
    state = _State(
        weights=weights.copy(),
        squared_error=n_samples * cost,
        alpha=0.0,
        beta=1.0,
        gamma=float(len(weights)),
        mu=options.mu,
    )
    for _ in range(options.epochs):
        if watch.over_budget():
            break
        _, hessian, gradient = objective.normal(state.weights)
        hessian, gradient = n_samples * hessian, n_samples * gradient
        slope = state.beta * gradient + state.alpha * state.weights
        if watch.at_rest(2.0 * slope):
            break
        if not _step(
            objective, state, hessian=hessian, slope=slope, n_samples=n_samples, options=options
        ):
            watch.outcome.stop = "mu"
            break
        state.gamma = _effective_weights(hessian, state)
        _balance(state, n_samples)
        watch.accept(state.weights, state.squared_error / n_samples)
    run = watch.outcome
    return BayesOutcome(
        state.weights,
        run.costs[-1],
        run.stop,
        run.costs,
        run.scores,
        state.alpha,
        state.beta,
        state.gamma,
    )


def _step(
    objective: Objective,
    state: _State,
    hessian: FloatArray,
    slope: FloatArray,
    n_samples: int,
    options: LmOptions,
) -> bool:
    """Move ``state`` to weights of lower regularised cost; return False if no step lowers it."""
    diagonal = np.arange(len(slope))
    while state.mu <= options.mu_max:
        damped = state.beta * hessian
        damped[diagonal, diagonal] += state.alpha + state.mu
        try:
            trial = state.weights - cho_solve(cho_factor(damped, check_finite=False), slope)
        except LinAlgError:
            state.mu *= options.mu_up
            continue
        squared_error = n_samples * objective.cost(trial)
        if state.beta * squared_error + state.alpha * float(trial @ trial) < state.cost:
            state.weights, state.squared_error = trial, squared_error
            state.mu = max(state.mu * options.mu_down, 1e-20)
            return True
        state.mu *= options.mu_up
    return False


def _balance(state: _State, n_samples: int) -> None:
    """Set alpha and beta by MacKay's fixed point, alpha = gamma/2E_W, beta = (N - gamma)/2E_D."""
    tiny = np.finfo(float).tiny
    state.alpha = state.gamma / (2.0 * max(float(state.weights @ state.weights), tiny))
    beta = (n_samples - state.gamma) / (2.0 * max(state.squared_error, tiny))
    state.beta = beta if beta > 0 else 1.0  # more weights than samples, as in the reference


def _effective_weights(hessian: FloatArray, state: _State) -> float:
    """Return gamma = n - alpha * trace((beta J'J + alpha I)^-1)."""
    n = len(hessian)
    matrix = state.beta * hessian
    matrix[np.arange(n), np.arange(n)] += state.alpha
    try:
        factor, _ = cho_factor(matrix, lower=True, check_finite=False)
    except LinAlgError:  # rounding: keep the last estimate
        return state.gamma
    inverse, _ = dtrtri(np.tril(factor), lower=1)
    return float(np.clip(n - state.alpha * np.sum(inverse**2), 0.0, n))
