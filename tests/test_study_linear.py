"""Linear baselines: dead times, orders, subspace, output error, residual tests, bad input.

The plants are continuous (exact solutions by scipy between the samples, dead times that are no
whole number of samples) or nonlinear tanks: none is an equation of the methods under test.
"""

import json

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, dlsim, lfilter

from monitor.errors import RecordingError, UsageError
from monitor.types import FloatArray
from training.metrics import fit_percent
from training.study.linear.arx import Arx, arx_delays, choose_arx, fit_arx, order_grid
from training.study.linear.baselines import Regime, linear, section
from training.study.linear.free_run import free_run_error
from training.study.linear.impulse import impulse_response
from training.study.linear.lagged import Stretch, triangle
from training.study.linear.output_error import OutputError, fit_output_error, refine
from training.study.linear.residual_tests import effective_samples, independence, whiteness
from training.study.linear.subspace import best_state_space, subspace

RNG = np.random.default_rng
PERIOD_S = 0.1
FINE = 10  # solution steps per sample


def held_steps(n: int, k: int, rng: np.random.Generator, longest: int = 25) -> FloatArray:
    """Inputs that hold a level for 2 to ``longest`` samples."""
    u = np.empty((n, k))
    for i in range(k):
        edges = np.cumsum(rng.integers(2, longest, n))
        u[:, i] = rng.standard_normal(n)[np.searchsorted(edges, np.arange(n), side="right")]
    return u


def coloured(n: int, rng: np.random.Generator, pole: float = 0.9) -> FloatArray:
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(n)))


def continuous(
    u: FloatArray, numerator: float, denominator: list[float], dead_s: float
) -> FloatArray:
    """Exact response of numerator / denominator(s) exp(-dead_s s) to an input held per sample."""
    fine = np.repeat(u, FINE)
    late = round(dead_s / PERIOD_S * FINE)
    fine = np.concatenate([np.full(late, fine[0]), fine])[: len(fine)]
    system = cont2discrete(([numerator], denominator), PERIOD_S / FINE)
    numerator_z, denominator_z = np.ravel(system[0]), np.ravel(system[1])
    return np.asarray(lfilter(numerator_z, denominator_z, fine))[::FINE]


def two_inputs(n: int, seed: int, noise: float = 0.05) -> Stretch:
    """Second order after 0.53 s of dead time, first order after 0.21 s, coloured noise."""
    rng = RNG(seed)
    u = held_steps(n, 2, rng)
    y = continuous(u[:, 0], 1.0, [0.04, 0.4, 1.0], 0.53)
    y += continuous(u[:, 1], -0.5, [0.3, 1.0], 0.21)
    return u, y + noise * coloured(n, rng)


def tank(n: int, seed: int) -> Stretch:
    """Two tanks under a pump, outflow by the root of the level, level sensor with noise."""
    rng = RNG(seed)
    u = 0.5 + 0.15 * held_steps(n, 1, rng, 60).clip(-2.0, 2.0)
    upper, lower, level = 0.25, 0.25, np.empty(n)
    for t in range(n):
        for _ in range(FINE):
            flow, out = np.sqrt(max(upper, 0.0)), np.sqrt(max(lower, 0.0))
            upper += PERIOD_S / FINE * (u[t, 0] - flow)
            lower += PERIOD_S / FINE * (flow - out)
        level[t] = lower
    return u, level + 0.005 * coloured(n, rng, 0.5)


def modes(n: int, rng: np.random.Generator, poles: FloatArray, disturbed: float) -> Stretch:
    """Continuous first-order modes of these poles (1/s), states disturbed, sensor noise."""
    readout = np.array([[1.0, -2.0, 1.5]])
    system = (np.diag(poles), np.ones((len(poles), 2)), readout, np.zeros((1, 2)))
    discrete = cont2discrete(system, PERIOD_S)
    u = rng.standard_normal((n, 1))
    driven = np.column_stack([u, disturbed * rng.standard_normal(n)])
    y = dlsim(discrete, driven)[1][:, 0]
    return u, y + 0.2 * disturbed * rng.standard_normal(n)


@pytest.fixture(scope="module")
def plants() -> list[Stretch]:
    return [two_inputs(1500, seed) for seed in range(4)]


def test_dead_times_of_a_continuous_plant_are_found_within_a_sample(plants: list[Stretch]) -> None:
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
        outside.append(np.mean(size > found.band))
        joint.append(found.delays()[1] is not None)
        naive.append(effective_samples([y], [u[:, 1]], 200) / 800)
    # THEN the second input's response leaves its 99 % bands about as often as they say
    assert np.mean(outside) < 0.03
    assert np.sum(joint) <= 2
    # and the raw samples are worth far fewer independent ones
    assert np.mean(naive) < 0.2


def test_the_bands_hold_the_true_response() -> None:
    u, y = two_inputs(6000, 11, noise=0.2)
    pulse = np.zeros(50)
    pulse[10] = 1.0
    true = continuous(pulse, -0.5, [0.3, 1.0], 0.21)[10:40]
    found = impulse_response([(u, y)], 30)
    inside = np.abs(found.response[1] - true) < found.band * found.standard_error[1]
    assert inside.mean() > 0.85
    assert np.abs(found.response[1] - true).max() < 0.03


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
    model = fit_arx(stretches, 2, 3, (1, 3))
    # THEN it is the least-squares solution of just these
    assert np.allclose(np.concatenate([[model.offset], *model.b, model.a]), theta, atol=1e-9)


def test_free_run_and_one_step_follow_the_difference_equation() -> None:
    rng = RNG(4)
    model = Arx(np.array([-1.1, 0.3]), rng.standard_normal((2, 2)), (0, 3), 0.4)
    u, y = rng.standard_normal((50, 2)), rng.standard_normal(50)
    free = y.copy()
    one_step = y.copy()
    for t in range(4, 50):
        drive = 0.4 + model.b[0] @ u[[t, t - 1], 0] + model.b[1] @ u[[t - 3, t - 4], 1]
        one_step[t] = drive - model.a @ y[[t - 1, t - 2]]
        if t >= 6:
            free[t] = drive - model.a @ free[[t - 1, t - 2]]
    assert np.allclose(model.simulate(u, y[:6]), free)
    assert np.allclose(model.predict(u, y), one_step)
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
    assert mdl.delays == (1,)
    assert 4 < mdl.n_parameters < aic.n_parameters
    assert 2 <= mdl.na <= 10
    assert mdl.validation_loss < 1.02 * best.validation_loss
    # and every loss is that of the model fitted by itself
    for c in (mdl, aic, best):
        u, y = stretches[1]
        model = fit_arx(stretches[:1], c.na, c.nb, c.delays)
        error = (y - model.predict(u, y))[24:]
        assert np.mean(error**2) == pytest.approx(c.validation_loss, rel=0.01)


def test_subspace_finds_order_and_poles_over_several_recordings() -> None:
    poles = np.array([-1.0, -3.0, -8.0])
    stretches = [modes(n, RNG(n), poles, 0.02) for n in (900, 1500, 2500)]
    found = subspace(triangle(stretches, 20, 20), 20, 10)
    best, errors = best_state_space(found, [modes(1500, RNG(5), poles, 0.02)], 20)
    assert found.order_by_gap == 3
    eigenvalues = np.sort(np.linalg.eigvals(found.models[2].A).real)
    assert np.allclose(eigenvalues, np.sort(np.exp(poles * PERIOD_S)), atol=0.02)
    assert best.order >= 3
    assert errors[2] < 1.05 * min(errors)
    assert errors[0] > 2.0 * errors[2]
    # and its polynomials behave alike
    u, y = stretches[0]
    assert np.allclose(
        best.transfer().simulate(u, y[:20])[300:], best.simulate(u, y[:20])[300:], atol=1e-6
    )


def test_a_state_space_model_starts_rightly_far_from_zero() -> None:
    # GIVEN signals in physical units, levels many times their spread
    u, y = two_inputs(3000, 6)
    u, y = 1e5 * (u + 30.0), 300.0 + 0.01 * y
    model = subspace(triangle([(u[:2000], y[:2000])], 20, 20), 20, 6).models[5]
    assert fit_percent(y[2020:], model.simulate(u[2000:], y[2000:2020])[20:]) > 80.0


def test_an_unstable_plant_is_said_to_be_unstable() -> None:
    # GIVEN outputs that run away
    rng = RNG(2)
    stretches = []
    for _ in range(4):
        u = rng.standard_normal((400, 1))
        stretches.append((u, lfilter([0.0, 1.0], [1.0, -1.02], u[:, 0])))
    # WHEN the baselines are fitted
    result = linear(stretches[:2], stretches[2:3], stretches[3:], ["u"], "y", period_s=PERIOD_S)
    # THEN a model that finds the plant is marked and not scored, and another one is chosen
    assert not result["models"]["arx_mdl"]["stable"]
    assert result["models"]["arx_mdl"]["fit_percent"] is None
    assert result["models"][result["best"]]["stable"]
    assert "unstable" in section(json.loads(json.dumps(result, allow_nan=False)))


def test_output_error_beats_arx_in_free_run_under_output_noise() -> None:
    # GIVEN a continuous second-order plant whose sensor alone is noisy
    def stretch(seed: int) -> Stretch:
        rng = RNG(seed)
        u = held_steps(1500, 1, rng)
        return u, continuous(u[:, 0], 2.0, [0.3, 0.6, 1.0], 0.0) + 0.5 * rng.standard_normal(1500)

    train, validate = [stretch(0), stretch(1)], [stretch(2)]
    arx = fit_arx(train, 2, 2, 1)
    # WHEN an output error model of the same order starts from the ARX
    found, _ = fit_output_error(train, validate, [arx], 20)
    # THEN its poles are the plant's, the ARX's are not, and its free run is nearer the truth
    poles = np.exp(np.roots([0.3, 0.6, 1.0]) * PERIOD_S)
    biased, right = (
        np.abs(np.sort_complex(np.roots(m.poly)) - np.sort_complex(poles)).max()
        for m in (arx, found.transfer)
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
    start, skip = fit_arx([(u, y)], 3, 4, (4, 2)), 15

    def error(theta: FloatArray) -> FloatArray:
        model = Arx(theta[:3], theta[4:].reshape(2, 4), start.delays, theta[3])
        return y[skip:] - OutputError(model).simulate(u, y[:skip])[skip:]

    first = np.concatenate([start.a, [start.offset], start.b.ravel()])
    wanted = 2.0 * least_squares(error, first, x_scale="jac").cost
    # WHEN both minimise the simulation error
    _, cost = refine(start, [(u, y)], skip, 10)
    # THEN they end at the same
    assert cost < 0.95 * np.sum(error(first) ** 2)
    assert cost < 1.0005 * wanted


@pytest.mark.parametrize("seed", range(4))
def test_output_error_never_diverges(seed: int) -> None:
    # GIVEN an unstable start on an output that the inputs do not explain
    rng = RNG(seed)
    records = [(rng.standard_normal((400, 2)), np.cumsum(rng.standard_normal(400)))]
    start = Arx(rng.uniform(-3, 3, 4), rng.standard_normal((2, 3)), (0, 2), 0.0)
    # WHEN it is refined
    model, cost = refine(start, records, 20, 20)
    # THEN it is stable, its cost is its own free-run error, and a long run stays bounded
    assert model.stable
    assert cost / 380 == pytest.approx(free_run_error(model, records, 20), rel=1e-6)
    run = model.simulate(rng.standard_normal((20_000, 2)), records[0][1][:20])
    assert np.isfinite(run).all()
    assert np.abs(run[-5000:]).max() < 1e4 * np.abs(records[0][1]).max()


def test_a_short_noisy_beginning_does_not_spoil_the_free_run() -> None:
    u, y = two_inputs(1200, 5, noise=0.0)
    model = OutputError(fit_arx([(u, y)], 4, 10, 0))
    spoilt = y[:25] + 0.3 * RNG(0).standard_normal(25)
    assert fit_percent(y[60:], model.simulate(u, spoilt)[60:]) > 90.0


def test_whiteness_and_independence_reject_an_undermodelled_plant() -> None:
    stretches = [modes(4000, RNG(s), np.array([-1.0, -3.0, -8.0]), 0.3) for s in (0, 1)]
    small = fit_arx(stretches[:1], 1, 1, 1)
    u, y = stretches[1]
    residual = [(y - small.predict(u, y))[1:]]
    assert whiteness(residual)["rejected"]
    assert independence(residual, [u[1:]], ["u"])[0]["rejected"]


def test_both_tests_accept_an_adequate_model_at_their_level() -> None:
    # GIVEN 60 fresh recordings of one plant and a large ARX of another recording
    poles = np.array([-1.0, -3.0, -8.0])
    model = fit_arx([modes(60_000, RNG(100), poles, 0.3)], 20, 20, 1)
    white, free = 0, 0
    for seed in range(60):
        u, y = modes(1500, RNG(seed), poles, 0.3)
        residual = [(y - model.predict(u, y))[20:]]
        white += whiteness(residual)["rejected"]
        free += independence(residual, [u[20:]], ["u"])[0]["rejected"]
    # THEN the tests at 1 % reject at most four of them, where 0.6 are expected
    assert white <= 4
    assert free <= 4


def test_feedback_is_not_taken_for_a_fault_of_the_model() -> None:
    rng = RNG(8)
    e, u, y = rng.standard_normal(4000), np.zeros(4000), np.zeros(4000)
    for t in range(1, 4000):
        y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1] + e[t]
        u[t] = -0.4 * y[t] + 0.3 * rng.standard_normal()
    (test,) = independence([e[1:]], [u[1:, None]], ["u"])
    assert test["feedback"]
    assert test["worst_lag"] == 0  # u(t) is made from y(t), hence from e(t)


@pytest.fixture(scope="module")
def tank_result() -> dict:  # type: ignore[type-arg]
    train, validate, test = ([tank(900, s) for s in r] for r in ((0, 1, 2), (3, 4), (5, 6)))
    regime = Regime("level", "m", [y for _, y in test])
    return linear(
        train, validate, test, ["pump"], "level", period_s=PERIOD_S, unit="m",
        regime=regime, max_order=6,
    )  # fmt: skip


def test_the_study_of_a_tank_is_complete_and_survives_json(tank_result: dict) -> None:  # type: ignore[type-arg]
    stored = json.dumps(tank_result, allow_nan=False)
    models = tank_result["models"]
    assert set(models) == {
        "arx_sum_of_squares", "arx_mdl", "arx_aic", "arx_free_run", "subspace", "output_error",
    }  # fmt: skip
    # a linear model follows most of the tank, chosen on validation it is near the best on test
    fits = {name: m["fit_percent"] for name, m in models.items()}
    assert fits[tank_result["best"]] > 70.0
    assert fits[tank_result["best"]] > max(fits.values()) - 3.0
    assert len(tank_result["regime"]["ranges"]) == 3
    scored = 2 * (900 - tank_result["skip"])
    assert sum(tank_result["regime"]["samples"]) == scored
    # the reference model can be run again from the stored coefficients
    kept = json.loads(stored)["arx"]["free_run_model"]
    again = Arx(np.array(kept["a"]), np.array(kept["b"]), tuple(kept["delays"]), kept["offset"])
    skip = tank_result["skip"]
    runs = [(y[skip:], again.simulate(u, y[:skip])[skip:]) for u, y in (tank(900, 5), tank(900, 6))]
    measured, run = (np.concatenate(side) for side in zip(*runs, strict=True))
    assert fit_percent(measured, run) == pytest.approx(fits["arx_free_run"], abs=0.01)
    html = section(json.loads(stored))
    assert html == section(tank_result)
    for words in ("Impulse responses", "Singular values", "residuals are white", "ARX, free run"):
        assert words in html


def test_the_reference_arx_is_the_best_free_run_of_the_grid(plants: list[Stretch]) -> None:
    train, validate = plants[:3], plants[3:]
    chosen = choose_arx(train, validate, max_order=8)
    error = free_run_error(chosen, validate, 16)
    for order in (1, 2, 4, 8):
        for delay in (0, 1, 3):
            rival = fit_arx(train, order, order, delay)
            assert error <= 1.001 * free_run_error(rival, validate, 16)
    assert error < 0.05**2 * 1.5  # near the noise


def test_a_few_hundred_samples_are_enough_for_small_orders() -> None:
    stretch = two_inputs(300, 1)
    result = linear([stretch], [two_inputs(200, 2)], [two_inputs(200, 3)], ["a", "b"], "y",
                    period_s=PERIOD_S)  # fmt: skip
    assert result["largest_order"] == 10
    assert result["models"][result["best"]]["fit_percent"] > 70.0


def test_bad_input_is_refused_with_one_clear_line(plants: list[Stretch]) -> None:
    u, y = plants[0]
    broken = u.copy()
    broken[7, 1] = np.nan
    names = ["a", "b"]

    def study(train: list[Stretch], **more: Regime) -> None:
        linear(train, [plants[1]], [plants[2]], names, "y", period_s=PERIOD_S, **more)

    with pytest.raises(RecordingError, match="training, stretch 1: b has values that are not fin"):
        study([(u, y), (broken, y)])
    with pytest.raises(RecordingError, match=r"training, stretch 0: inputs \(1500, 1\)"):
        study([(u[:, :1], y)])
    with pytest.raises(RecordingError, match="40 samples in 1 stretches are too few"):
        study([(u[:40], y[:40])])
    with pytest.raises(RecordingError, match=r"training: the output is constant \(2\)"):
        study([(u, np.full(len(y), 2.0))])
    with pytest.raises(RecordingError, match="training: no stretch"):
        study([])
    with pytest.raises(UsageError, match=r"speed: \(10,\) values for test stretch 0"):
        study([(u, y)], regime=Regime("speed", "rpm", [y[:10]]))
