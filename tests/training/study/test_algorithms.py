"""Training algorithms on problems that are not the NARX's own equations."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.optimize import minimize, rosen, rosen_der
from scipy.stats import multivariate_normal

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import minimise
from training.narx.algorithms.objectives import ClosedLoop, Pieces, Samples, one_step
from training.narx.network import Spec, forward, initial_weights, regressors
from training.study.narx.bayes import minimise_bayesian
from training.study.narx.first_order import descend, minimise_scaled_conjugate, one_step_by_torch


@dataclass
class Bowl:
    """A paraboloid with curvatures ``steep`` and its minimum 0 at 0; notes what it is asked."""

    steep: FloatArray
    asked: list[float] = field(default_factory=list)

    def __call__(self, w: FloatArray) -> tuple[float, FloatArray]:
        self.asked.append(float(w[0]))
        return float(0.5 * self.steep @ w**2), self.steep * w


@dataclass
class Line:
    """Least squares of a line through basis functions: no network at all."""

    basis: FloatArray
    target: FloatArray

    def cost(self, w: FloatArray) -> float:
        return float(np.mean((self.basis @ w - self.target) ** 2))

    def normal(self, w: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        n = len(self.target)
        error = self.basis @ w - self.target
        return self.cost(w), self.basis.T @ self.basis / n, self.basis.T @ error / n


def ripple(n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Noisy samples of a function no tanh network contains."""
    x = rng.uniform(-2, 2, size=(n, 2))
    return x, np.cos(2 * x[:, 0]) * np.exp(-(x[:, 1] ** 2)) + 0.15 * rng.standard_normal(n)


@pytest.mark.parametrize("linear_path", [False, True])
@pytest.mark.parametrize("hidden", [(4,), (5, 3), (3, 5, 4)])
def test_the_gradient_of_torch_is_that_of_the_normal_equations(
    hidden: tuple[int, ...], linear_path: bool
) -> None:
    rng = np.random.default_rng(1)
    spec, n = Spec(2, lags=2, hidden=hidden, linear_path=linear_path), 4500
    u, y, weight = rng.normal(size=(n, 2)), rng.normal(size=n), rng.uniform(0, 2, n)
    weights, at = rng.normal(size=spec.n_weights), np.arange(2, n)
    cost, gradient = one_step_by_torch(spec, regressors(spec, u, y), y[2:], weight[2:])(weights)
    wanted, _, half = one_step(spec, Samples(u, y, weight), at, np.float64).normal(weights)
    assert cost == pytest.approx(wanted, rel=1e-12)
    assert np.allclose(gradient, 2.0 * half, atol=1e-12)
    assert np.abs(gradient).min() > 1e-5  # every weight takes part


def test_scaled_conjugate_gradient_follows_a_curved_valley_to_its_end() -> None:
    # GIVEN Rosenbrock's function, whose minimum 0 is at (1, 1)
    outcome = minimise_scaled_conjugate(lambda w: (rosen(w), rosen_der(w)), np.array([-1.2, 1.0]))
    assert np.allclose(outcome.weights, 1.0, atol=1e-4)
    assert outcome.stop == "gradient"
    assert np.all(np.diff(outcome.costs) <= 0)


def test_the_momentum_step_is_the_documented_one() -> None:
    # GIVEN a parabola and a rate at which nothing overshoots
    bowl = Bowl(np.array([2.0]))
    descend(bowl, np.array([1.0]), 3, 0.01)
    # THEN every step is 0.9 times the last one plus 0.9 * rate * slope, the rate growing by 1.05
    w, step, rate = 1.0, -0.01 * 2.0, 0.01
    for reached in bowl.asked[1:]:
        step = 0.9 * step - 0.9 * rate * 2.0 * w
        w += step
        assert reached == pytest.approx(w, rel=1e-12)
        rate *= 1.05
    assert len(bowl.asked) == 4


def test_a_step_that_raises_the_error_is_taken_back_and_the_rate_falls() -> None:
    # GIVEN a rate far too large for the slope
    bowl = Bowl(np.array([100.0]))
    outcome = descend(bowl, np.array([1.0]), 400, 1.0)
    # THEN the first trials are taken back, and the descent still arrives
    assert outcome.costs[1] == outcome.costs[0]
    assert bowl.asked[2] - 1.0 == pytest.approx(0.7 * (bowl.asked[1] - 1.0), rel=1e-12)
    assert outcome.score < 1e-6
    rises = np.array(outcome.costs[1:]) / np.maximum(outcome.costs[:-1], 1e-300)
    assert rises.max() <= 1.04 + 1e-12


@pytest.mark.parametrize("method", [descend, minimise_scaled_conjugate])
def test_training_stops_after_six_validation_failures_and_keeps_the_best(
    method: Callable[..., object],
) -> None:
    # GIVEN a validation error that is lowest on the way, at half the distance
    bowl = Bowl(np.geomspace(1.0, 50.0, 8))
    outcome = method(bowl, np.ones(8), validate=lambda w: abs(float(w[0]) - 0.5))
    scores = np.array(outcome.scores)  # type: ignore[attr-defined]
    assert outcome.stop == "validation"  # type: ignore[attr-defined]
    assert outcome.score == scores.min()  # type: ignore[attr-defined]
    assert abs(outcome.weights[0] - 0.5) == scores.min()  # type: ignore[attr-defined]
    assert np.all(scores[-6:] >= scores.min())


def test_the_evidence_settles_where_the_marginal_likelihood_is_highest() -> None:
    # GIVEN a noisy parabola and nine polynomials
    rng = np.random.default_rng(3)
    x = np.linspace(-1, 1, 60)
    basis = np.polynomial.legendre.legvander(x, 8)
    target = 0.5 + x - 0.8 * x**2 + 0.1 * rng.standard_normal(60)
    # WHEN Bayesian regularisation and, independently, the marginal likelihood choose
    outcome, found = minimise_bayesian(Line(basis, target), np.zeros(9) + 0.1, 60)

    def negative_evidence(log: FloatArray) -> float:
        alpha, beta = np.exp(log)
        covariance = np.eye(60) / (2 * beta) + basis @ basis.T / (2 * alpha)
        return -float(multivariate_normal(np.zeros(60), covariance).logpdf(target))

    best = np.exp(minimize(negative_evidence, np.log([1.0, 50.0]), method="Nelder-Mead").x)
    # THEN they agree, on the weights too
    assert found.alpha == pytest.approx(best[0], rel=0.01)
    assert found.beta == pytest.approx(best[1], rel=0.01)
    ridge = basis.T @ basis + best[0] / best[1] * np.eye(9)
    assert np.allclose(outcome.weights, np.linalg.solve(ridge, basis.T @ target), atol=1e-3)
    curvature = best[1] * np.linalg.eigvalsh(basis.T @ basis)
    effective = np.sum(curvature / (curvature + best[0]))
    assert found.effective_weights == pytest.approx(effective, rel=1e-3)


@pytest.mark.parametrize("seed", [0, 1])
def test_bayesian_regularisation_does_not_overfit_where_levenberg_marquardt_does(seed: int) -> None:
    # GIVEN 81 weights and 120 noisy samples
    rng = np.random.default_rng(seed)
    spec = Spec(1, lags=1, hidden=(20,), input_lag_start=0, input_boxes=((0, 1),))
    x, y = ripple(120, rng)
    fresh_x, fresh_y = ripple(2000, rng)
    weights, at = initial_weights(spec, rng), np.arange(1, 121)
    samples = Samples(np.append(0.0, x[:, 0])[:, None], np.append(0.0, y), np.ones(121))
    objective = ClosedLoop(spec, samples, Pieces(at, at + 1, 0 * at, x[:, 1:]))
    free = minimise(objective, weights, epochs=100)
    regular, found = minimise_bayesian(objective, weights, len(y), 100)
    # THEN it fits the samples less closely and the function better, with fewer effective weights
    error = [np.mean((forward(spec, o.weights, fresh_x) - fresh_y) ** 2) for o in (free, regular)]
    assert regular.costs[-1] > free.costs[-1]
    assert error[1] < 0.5 * error[0]
    assert 10 < found.effective_weights < 0.6 * spec.n_weights


@pytest.mark.parametrize("method", [descend, minimise_scaled_conjugate])
def test_an_error_that_is_not_finite_at_the_start_is_refused(method: Callable[..., object]) -> None:
    with pytest.raises(ValueError, match="at the initial weights"):
        method(Bowl(np.array([np.inf])), np.ones(1))
    with pytest.raises(ValueError, match="at the initial weights"):
        minimise_bayesian(Line(np.ones((3, 1)), np.full(3, np.nan)), np.ones(1), 3)
