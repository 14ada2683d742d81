"""The study of linear baselines: residual tests, tanks as a whole, bad input."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor.base.errors import RecordingError
from tests.helpers.models.plants import PERIOD_S, RNG, fit_arx, leaking_tank, modes, two_inputs
from training.narx.fit import FitOptions
from training.narx.linear.arx import arx_delays, best_in_free_run, triangle
from training.narx.linear.models import Stretch, free_run_error
from training.narx.linear.responses import correlation, independence, whiteness
from training.study import choice
from training.study.baselines import linear
from training.study.page import section
from training.study.task import Settings
from training.study.words import TITLES


@pytest.fixture(scope="module")
def plants() -> list[Stretch]:
    return [two_inputs(1500, seed) for seed in range(4)]


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
    assert "unstable" in section(
        "linear", {"linear": json.loads(json.dumps(result, allow_nan=False))}
    )


def test_a_short_record_has_its_linear_baselines() -> None:
    # GIVEN a record whose held-out blocks have 50 samples
    u, y = two_inputs(600, 5)
    parts = [(u[i : i + 60], y[i : i + 60]) for i in range(0, 600, 60)]
    held_out = [(a[:50], b[:50]) for a, b in parts[:2]]
    # WHEN the baselines are fitted THEN shorter models take the place of none
    result = linear(parts[2:], held_out[:1], held_out[1:], ["a", "b"], "y", period_s=PERIOD_S)
    assert 2 <= result["largest_order"] <= 12
    assert result["models"][result["best"]]["fit_percent"] > 50


def test_stretches_too_short_for_fifty_lags_have_shorter_responses() -> None:
    parts = [(u[:, :1], y) for u, y in (two_inputs(70, seed) for seed in range(20))]
    result = linear(parts[:16], parts[16:18], parts[18:], ["a"], "y", period_s=PERIOD_S)
    assert len(result["impulse"]["rows"][0]["response"]) == 29


def test_whiteness_and_independence_reject_an_undermodelled_plant() -> None:
    stretches = [modes(4000, RNG(s), np.array([-1.0, -3.0, -8.0]), 0.3) for s in (0, 1)]
    small = fit_arx(stretches[:1], 1, 1, 1)
    u, y = stretches[1]
    residual = small.errors(u, y)[1:]
    assert whiteness(residual)["rejected"]
    assert independence(residual, u[1:], ["u"])[0]["rejected"]


def test_both_tests_accept_an_adequate_model_at_their_level() -> None:
    # GIVEN 60 fresh recordings of one plant and a large ARX of another recording
    poles = np.array([-1.0, -3.0, -8.0])
    model = fit_arx([modes(60_000, RNG(100), poles, 0.3)], 20, 20, 1)
    white, free = 0, 0
    for seed in range(60):
        u, y = modes(1500, RNG(seed), poles, 0.3)
        residual = model.errors(u, y)[20:]
        white += whiteness(residual)["rejected"]
        free += independence(residual, u[20:], ["u"])[0]["rejected"]
    # THEN the tests at 1 % reject at most four of them, where 0.6 are expected
    assert white <= 4
    assert free <= 4


def test_feedback_is_not_taken_for_a_fault_of_the_model() -> None:
    rng = RNG(8)
    e, u, y = rng.standard_normal(4000), np.zeros(4000), np.zeros(4000)
    for t in range(1, 4000):
        y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1] + e[t]
        u[t] = -0.4 * y[t] + 0.3 * rng.standard_normal()
    (test,) = independence(e[1:], u[1:, None], ["u"])
    assert test["feedback"]
    assert np.abs(correlation(e[1:], u[1:], range(26))).argmax() == 0  # u(t) is made from e(t)


def test_the_study_of_a_tank_is_complete_and_survives_json() -> None:
    def tank(seed: int) -> Stretch:
        *inputs, level = leaking_tank(900, seed, 0.5)
        return np.column_stack(inputs), level

    train, validate, test = (list(map(tank, seeds)) for seeds in ((0, 1, 2), (3, 4), (5, 6)))
    tank_result = linear(train, validate, test, ["valve", "leak"], "level", period_s=PERIOD_S)
    stored = json.dumps(tank_result, allow_nan=False)
    models = tank_result["models"]
    assert set(models) == set(TITLES)
    # a linear model follows most of the tank, chosen on validation it is near the best on test
    fits = {name: m["fit_percent"] for name, m in models.items()}
    assert fits[tank_result["best"]] > 70.0
    assert fits[tank_result["best"]] > max(fits.values()) - 3.0
    html = section("linear", {"linear": json.loads(stored)})
    assert html == section("linear", {"linear": tank_result})
    for words in ("Impulse responses", "residuals are white", "ARX, free run"):
        assert words in html


def test_the_reference_arx_is_the_best_free_run_of_the_grid(plants: list[Stretch]) -> None:
    train, validate = plants[:3], plants[3:]
    data = triangle(train, 8, 16)
    chosen = best_in_free_run(data, validate, 8, arx_delays(data, 8))
    error = free_run_error(chosen, validate, 16)
    for order in (1, 2, 4, 8):
        for delay in (0, 1, 3):
            rival = fit_arx(train, order, order, delay, delay)
            assert error <= 1.001 * free_run_error(rival, validate, 16)
    assert error < 0.05**2 * 1.5  # near the noise


def test_bad_input_is_refused_with_one_clear_line(plants: list[Stretch]) -> None:
    u, y = plants[0]
    names = ["a", "b"]

    def study(train: list[Stretch]) -> None:
        linear(train, [plants[1]], [plants[2]], names, "y", period_s=PERIOD_S)

    with pytest.raises(RecordingError, match="40 samples in 1 stretches are too few"):
        study([(u[:40], y[:40])])
    with pytest.raises(RecordingError, match=r"training: the output is constant \(2\)"):
        study([(u, np.full(len(y), 2.0))])
    with pytest.raises(RecordingError, match="training: no stretch"):
        study([])


def test_the_model_of_the_study_leaves_the_blocks_alone_that_compare_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit(source: Any, path: Path, options: FitOptions) -> None:
        assert options.keep_held_out
        raise RecordingError("enough is known")

    monkeypatch.setattr(choice, "fit", fit)
    task = SimpleNamespace(
        folder=tmp_path, settings=Settings(), recordings=[], inputs=[], output="y", jobs=1
    )
    with pytest.raises(RecordingError, match="enough is known"):
        choice.free_structure(task, {})  # type: ignore[arg-type]
