"""Bayesian regularisation: Levenberg–Marquardt on the error and the weights, balanced by evidence.

The objective is beta * E_D + alpha * E_W, with E_D the sum of squared errors and E_W the sum of
squared weights. After every step alpha and beta follow from gamma, the effective number of
parameters. So the training needs no validation set, and none stops it.

Source: MacKay, Bayesian interpolation, Neural Computation 4 (1992); Foresee and Hagan,
Gauss-Newton approximation to Bayesian learning, ICNN (1997); defaults of the reference toolbox
(1,000 epochs, mu 0.005, x0.1, x10, at most 1e10, minimum gradient 1e-7).
"""

import numpy as np
from scipy.linalg import LinAlgError, cho_factor
from scipy.linalg.lapack import dtrtri

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOutcome, Objective, Watch, damped_step

MU = 0.005
TINY = np.finfo(float).tiny


class BayesianError:
    """The regularised objective and its balance between error and weights.

    objective : mean over samples, so that ``n_samples`` times its cost is the sum of squares
    Foresee and Hagan begin with alpha 0 and beta 1; the first step sets both right.
    """

    def __init__(self, objective: Objective, n_samples: int, n_weights: int) -> None:
        self._objective, self._n = objective, n_samples
        self.alpha, self.beta = 0.0, 1.0  # inverse variances of weights and noise, over two
        self.effective_weights = float(n_weights)  # gamma

    def cost(self, weights: FloatArray) -> float:
        """Return beta E_D + alpha E_W."""
        squares = self._n * self._objective.cost(weights)
        return self.beta * squares + self.alpha * float(weights @ weights)

    def normal(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the cost and half of its curvature and slope."""
        cost, hessian, gradient = self._objective.normal(weights)
        scale = self.beta * self._n
        curvature = scale * hessian + self.alpha * np.eye(len(weights))
        whole = scale * cost + self.alpha * float(weights @ weights)
        return whole, curvature, scale * gradient + self.alpha * weights

    def balance(self, weights: FloatArray, curvature: FloatArray) -> float:
        """Set alpha and beta by MacKay's fixed point; return the mean squared error.

        alpha = gamma / 2 E_W, beta = (N - gamma) / 2 E_D, gamma = n - alpha trace(curvature^-1)
        """
        n, mean_square = len(weights), self._objective.cost(weights)
        try:
            factor, _ = cho_factor(curvature, lower=True, check_finite=False)
            inverse, _ = dtrtri(np.tril(factor), lower=1)
            gamma = n - self.alpha * float(np.sum(inverse**2))
            self.effective_weights = float(np.clip(gamma, 0.0, n))
        except LinAlgError:  # rounding: keep the last estimate
            pass
        self.alpha = self.effective_weights / (2.0 * max(float(weights @ weights), TINY))
        beta = (self._n - self.effective_weights) / (2.0 * max(self._n * mean_square, TINY))
        self.beta = beta if beta > 0 else 1.0  # more weights than samples, as in the reference
        return mean_square


def minimise_bayesian(
    objective: Objective, weights: FloatArray, n_samples: int, epochs: int = 1000
) -> tuple[LmOutcome, BayesianError]:
    """Return the last weights, on which the evidence settles, with their mean squared error.

    Raises ValueError if the objective is not finite at the start.
    """
    evidence, mu = BayesianError(objective, n_samples, len(weights)), MU
    watch = Watch(weights, objective.cost(weights))
    for _ in range(epochs):
        _, curvature, slope = evidence.normal(weights)
        if watch.at_rest(2.0 * slope):
            break
        step = damped_step(evidence, weights, (evidence.cost(weights), curvature, slope), mu)
        if step is None:
            watch.outcome.stop = "mu"
            break
        weights, _, mu = step
        watch.accept(weights, evidence.balance(weights, curvature))
    run = watch.outcome
    run.weights, run.score = weights, run.costs[-1]
    return run, evidence
