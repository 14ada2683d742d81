"""Linear baselines one by one: dead times, orders, state space, output error."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from monitor.base.types import FloatArray
from tests.helpers.models.plants import (
    PERIOD_S,
    RNG,
    coloured,
    continuous,
    fit_arx,
    held_steps,
    modes,
    two_inputs,
)
from training.narx.linear.arx import arx_delays, order_grid, triangle
from training.narx.linear.models import LinearModel, Stretch, free_run_error, free_runs
from training.narx.linear.prediction_error import refine
from training.narx.linear.responses import band, effective_samples, impulse_response
from training.recordings.metrics import fit_percent


def test_dead_times_of_a_continuous_plant_are_found_within_a_sample() -> None:
    plants = [two_inputs(1500, seed) for seed in range(4)]
    # GIVEN dead times of 0.53 and 0.21 s: an edge first moves the sample after, number 6 and 3
    # WHEN they are read from the impulse responses and from ARX models of order 2
    from_impulse = impulse_response(plants, 30).delays()
    from_arx = arx_delays(triangle(plants, 20, 22))
    # THEN both are right within one sample
    for found in (from_impulse, from_arx):
        assert np.abs(np.array(found, dtype=float) - [6, 3]).max() <= 1


def test_bands_of_an_input_without_effect_hold_under_coloured_noise() -> None:
    # GIVEN slow inputs and slow noise, so that neighbouring samples tell nearly the same
    outside, joint, naive = [], [], []
    for seed in range(25):
        rng = RNG(seed)
        u = np.column_stack([coloured(800, rng, 0.95), coloured(800, rng, 0.95)])
        y = continuous(u[:, 0], 1.0, [0.5, 1.0], 0.2) + coloured(800, rng, 0.97)
        found = impulse_response([(u, y)], 15)
        size = np.abs(found.response[1]) / found.standard_error[1]
        outside.append(np.mean(size > band()))
        joint.append(found.delays()[1] is not None)
        naive.append(effective_samples(y, u[:, 1], 200) / 800)
    # THEN the second input's response leaves its 99 % bands about as often as they say
    assert np.mean(outside) < 0.03
    assert np.sum(joint) <= 2
    # and the raw samples are worth far fewer independent ones
    assert np.mean(naive) < 0.2


def test_no_regressor_reaches_across_a_gap() -> None:
    # GIVEN two stretches at different levels and the regressors written out one by one
    rng = RNG(3)
    stretches = [(rng.standard_normal((60, 2)) + s, rng.standard_normal(60) - s) for s in (0, 50)]
    rows, targets = [], []
    for u, y in stretches:
        for t in range(5, 60):
            taps = [*u[[t - 1, t - 2, t - 3], 0], *u[[t - 3, t - 4, t - 5], 1]]
            rows.append([1.0, *taps, -y[t - 1], -y[t - 2]])
            targets.append(y[t])
    theta = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]
    # WHEN the model is fitted
    model = fit_arx(stretches, 2, 3, 1, 3)
    # THEN it is the least-squares solution of just these
    assert np.allclose(np.concatenate([[model.offset], *model.b, model.a]), theta, atol=1e-9)


@pytest.mark.parametrize("c", [0.0, 0.4])
def test_free_run_and_one_step_follow_the_difference_equation(c: float) -> None:
    # GIVEN the equation written out sample by sample, an error e in each sample from the fourth on
    rng, a = RNG(4), np.array([-1.1, 0.3])
    model = LinearModel(a, rng.standard_normal((2, 2)), (0, 3), 0.4, c=np.array([c]))
    u, y, e = rng.standard_normal((50, 2)), rng.standard_normal(50), rng.standard_normal(50)
    e[:4] = 0.0
    free = y.copy()
    for t in range(4, 50):
        drive = 0.4 + model.b[0] @ u[[t, t - 1], 0] + model.b[1] @ u[[t - 3, t - 4], 1]
        y[t] = drive - a @ y[[t - 1, t - 2]] + e[t] + c * e[t - 1]
        free[t] = y[t] if t < 6 else drive - a @ free[[t - 1, t - 2]] + c * e[5] * (t == 6)
    # THEN one step errs by e, and the free run behind six samples has no further one
    assert np.allclose(model.errors(u, y), e)
    assert np.allclose(model.simulate(u, y[:6]), free)
    with pytest.raises(ValueError, match="3 first outputs, the model needs 4"):
        model.simulate(u, y[:3])


def test_criteria_choose_sensible_orders() -> None:
    # GIVEN three continuous modes with a disturbance of the states
    stretches = [modes(4000, RNG(s), np.array([-1.0, -3.0, -8.0]), 0.3) for s in (0, 1)]
    data, held_out = triangle(stretches[:1], 24, 24), triangle(stretches[1:], 24, 24)
    # WHEN all orders are compared
    grid = order_grid(data, held_out, 20, [(d,) for d in range(4)])
    mdl, aic = min(grid, key=lambda c: c.mdl), min(grid, key=lambda c: c.aic)
    best = min(grid, key=lambda c: c.validation_loss)
    # THEN the dead time is that of sampling, MDL is the smallest, and none is far from the plant
    assert mdl.model.delays == (1,)
    assert 4 < mdl.model.n_parameters < aic.model.n_parameters
    assert 2 <= len(mdl.model.a) <= 10
    assert mdl.validation_loss < 1.02 * best.validation_loss
    # and every loss is that of the model fitted by itself
    for c in (mdl, aic, best):
        error = c.model.errors(*stretches[1])[24:]
        assert np.mean(error**2) == pytest.approx(c.validation_loss, rel=1e-6)


def test_state_space_models_have_the_poles_of_the_plant_over_several_recordings() -> None:
    poles = np.array([-1.0, -3.0, -8.0])
    stretches = [modes(n, RNG(n), poles, 0.02) for n in (900, 1500, 2500)]
    held_out = [modes(1500, RNG(5), poles, 0.02)]
    starts = [fit_arx(stretches, n, n + 1, 0) for n in (1, 2, 3, 4)]
    found = [refine(start, stretches, 20, output_error=False) for start in starts]
    errors = [free_run_error(m, held_out, 20) for m in found]
    eigenvalues = np.sort(np.roots(found[2].poly).real)
    assert np.allclose(eigenvalues, np.sort(np.exp(poles * PERIOD_S)), atol=0.02)
    assert errors[2] < 1.05 * min(errors)
    assert errors[0] > 2.0 * errors[2]


def test_output_error_beats_arx_in_free_run_under_output_noise() -> None:
    # GIVEN a continuous second-order plant whose sensor alone is noisy
    def stretch(seed: int) -> Stretch:
        rng = RNG(seed)
        u = held_steps(1500, 1, rng)
        return u, continuous(u[:, 0], 2.0, [0.3, 0.6, 1.0], 0.0) + 0.5 * rng.standard_normal(1500)

    train = [stretch(0), stretch(1)]
    arx = fit_arx(train, 2, 2, 1)
    # WHEN an output error model of the same order starts from the ARX
    found = refine(arx, train, 20)
    # THEN its poles are the plant's, the ARX's are not, and its free run is nearer the truth
    poles = np.exp(np.roots([0.3, 0.6, 1.0]) * PERIOD_S)
    biased, right = (
        np.abs(np.sort_complex(np.roots(m.poly)) - np.sort_complex(poles)).max()
        for m in (arx, found)
    )
    assert right < 0.02 < biased
    rng = RNG(9)
    u = held_steps(1500, 1, rng)
    y = continuous(u[:, 0], 2.0, [0.3, 0.6, 1.0], 0.0)
    fits = [fit_percent(y[20:], m.simulate(u, y[:20])[20:]) for m in (arx, found)]
    assert fits[1] > 95.0 and fits[1] > fits[0] + 10.0


def test_output_error_reaches_in_ten_steps_what_numerical_least_squares_reaches() -> None:
    # GIVEN a start by ARX on noisy samples, two inputs, initial conditions unknown
    u, y = two_inputs(700, 21, noise=0.0)
    y += 0.3 * RNG(22).standard_normal(700)
    start, skip = fit_arx([(u, y)], 3, 4, 4, 2), 15

    def error(theta: FloatArray) -> FloatArray:
        a, b = theta[:3], theta[4:].reshape(2, 4)
        model = LinearModel(a, b, start.delays, theta[3], c=a)
        return y[skip:] - model.simulate(u, y[:skip])[skip:]

    first = np.concatenate([start.a, [start.offset], start.b.ravel()])
    wanted = 2.0 * least_squares(error, first, x_scale="jac").cost
    # WHEN both minimise the simulation error
    cost = free_run_error(refine(start, [(u, y)], skip, 10), [(u, y)], skip)
    # THEN they end at the same
    assert cost < 0.95 * np.mean(error(first) ** 2)
    assert cost < 1.0005 * wanted / (700 - skip)


@pytest.mark.parametrize("seed", range(4))
def test_output_error_never_diverges(seed: int) -> None:
    # GIVEN an unstable start on an output that the inputs do not explain
    rng = RNG(seed)
    records = [(rng.standard_normal((400, 2)), np.cumsum(rng.standard_normal(400)))]
    start = LinearModel(rng.uniform(-3, 3, 4), rng.standard_normal((2, 3)), (0, 2), 0.0)
    # WHEN it is refined
    model = refine(start, records, 20, 20)
    # THEN it is stable, and a long run stays bounded
    assert model.stable
    run = model.simulate(rng.standard_normal((20_000, 2)), records[0][1][:20])
    assert np.isfinite(run).all()
    assert np.abs(run[-5000:]).max() < 1e4 * np.abs(records[0][1]).max()


def test_a_stretch_as_short_as_its_start_is_all_measured() -> None:
    # GIVEN a model without memory of its output, and a stretch between two readings left out
    model = LinearModel(delays=(0,), b=np.array([[0.5]]), a=np.zeros(0), offset=0.0)
    short, long = np.ones((3, 1)), np.ones((5, 1))
    # WHEN both run freely behind three measured samples
    runs = free_runs(model, [(short, np.full(3, 2.0)), (long, np.full(5, 2.0))], skip=3)
    # THEN the short one is what was measured
    assert [run.tolist() for run in runs] == [[2.0, 2.0, 2.0], [2.0, 2.0, 2.0, 0.5, 0.5]]
