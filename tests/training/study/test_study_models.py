"""The NARX study: its models, figures and words; its jobs stored, killed, on a cluster."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from tests.helpers.drives.recordings import recording_of
from tests.helpers.models.plants import TANK_PERIOD_S, leaking_tank
from training.narx.network import Spec, initial_weights
from training.narx.search.stages import blocks_of
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, prepare
from training.study.narx.candidates import (
    BAYES,
    CANDIDATES,
    CONJUGATE,
    DESCENT,
    LM,
    PAPER,
    ModelCandidate,
    same_as,
)
from training.study.narx.models import NOT_USED, Job, figures, spec_from, spec_of, thin, train_one
from training.study.narx.study import compared
from training.study.narx.verdicts import judge
from training.study.page import section
from training.study.results import stored
from training.study.task import Settings

FEW = (
    ModelCandidate(number=1, algorithm=LM, lags=3, hidden=(4,), rate=0.2, origin=PAPER),
    ModelCandidate(2, LM, 3, (4,), 0.01),
    ModelCandidate(3, BAYES, 2, (3,)),
    ModelCandidate(4, CONJUGATE, 3, (3, 3)),
    ModelCandidate(5, DESCENT, 3, (4,), 0.05),
)
SETTINGS = Settings(starts=2, iterations=25, n_samples=900, tune_best=1)


def drive(n: int, seed: int, name: str) -> Recording:
    """A recording of a tank with a valve and a leak."""
    columns = zip(("valve", "leak", "level_m"), leaking_tank(n, seed, 0.5), strict=True)
    return recording_of(dict(columns), name, TANK_PERIOD_S)


@pytest.fixture(scope="module")
def data() -> Prepared:
    """Return a longer and a shorter recording, prepared."""
    recordings = [drive(1500, 1, "morning"), drive(900, 2, "evening")]
    return prepare(recordings, ["valve", "leak"], "level_m", block_s=25.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def result(data: Prepared, folder: Path) -> dict[str, Any]:
    return compared(data, folder, SETTINGS, FEW, jobs=1)


def test_the_29_models_cover_what_is_known_of_the_paper() -> None:
    assert [c.number for c in CANDIDATES] == list(range(1, 30))
    assert {c.lags for c in CANDIDATES} == {3, 5, 8}
    assert {len(c.hidden) for c in CANDIDATES} == {1, 2}
    assert {min(c.hidden) for c in CANDIDATES} >= {5, 15}
    assert all(5 <= n <= 15 for c in CANDIDATES for n in c.hidden)
    assert {c.algorithm for c in CANDIDATES} == {LM, BAYES, CONJUGATE, DESCENT}
    (paper,) = [c for c in CANDIDATES if c.origin == PAPER]
    assert (paper.lags, paper.hidden, paper.algorithm, paper.rate) == (5, (8, 8), LM, 0.2)


def test_only_models_that_differ_in_an_unused_learning_rate_coincide() -> None:
    assert same_as(CANDIDATES) == {2: 1, 3: 1}
    rates = [c for c in CANDIDATES if c.algorithm == DESCENT and c.hidden == (8, 8)]
    assert len({c.rate for c in rates}) == 3
    assert not same_as(rates)


def test_coinciding_models_are_trained_once(result: dict[str, Any], folder: Path) -> None:
    one, two = result["models"][:2]
    assert two["same_as"] == 1
    assert one["starts"] == two["starts"]
    assert len(list(folder.glob("train_*.json"))) == 4 * SETTINGS.starts
    assert 2 not in result["ranking"]


@pytest.mark.parametrize("n_samples", [200, 700, 1200])
def test_thinning_keeps_whole_blocks_of_all_recordings(data: Prepared, n_samples: int) -> None:
    less = thin(data, n_samples)
    kept = less.role == Role.TRAIN
    assert n_samples - 60 <= kept.sum() <= n_samples
    assert np.all(data.role[kept] == Role.TRAIN)
    assert np.all(data.role[less.role == NOT_USED] == Role.TRAIN)
    for role in (Role.VALIDATE, Role.TEST):
        assert np.array_equal(less.role == role, data.role == role)
    shares = [kept[s.start : s.stop].sum() / (s.stop - s.start) for s in data.segments]
    assert min(shares) > 0.5 * max(shares)


def test_figures_are_those_of_a_plain_simulation(data: Prepared) -> None:
    # GIVEN a network
    spec = replace(spec_of(data, FEW[3]), lags=2)
    weights = 0.7 * initial_weights(spec, np.random.default_rng(1))
    found = figures(data, spec, weights)
    # WHEN it is run step by step from the first two measurements of each recording
    free = np.full(len(data.role), np.nan)
    for s in data.segments:
        past = data.samples.y[s.start : s.start + 2][::-1]
        for t in range(s.start + 2, s.stop):
            x = np.concatenate([data.samples.u[t - 1], data.samples.u[t - 2], past])
            free[t] = np.clip(plain_network(spec, weights, x), spec.y_min, spec.y_max)
            past = np.array([free[t], past[0]])
    # THEN R and MSE on the test blocks are those reported
    at = np.flatnonzero((data.role == Role.TEST) & np.isfinite(free))
    measured = data.samples.y[at]
    test = found["free_run"]["test"]["enabled"]
    assert test["samples"] == len(at)
    assert test["r"] == pytest.approx(np.corrcoef(measured, free[at])[0, 1], abs=1e-4)
    assert test["mse"] == pytest.approx(np.mean((measured - free[at]) ** 2), rel=1e-4)


def plain_network(spec: Spec, weights: FloatArray, x: FloatArray) -> float:
    at = 0
    for i, (a, b) in enumerate(zip(spec.sizes[:-1], spec.sizes[1:], strict=True)):
        x = weights[at : at + a * b].reshape(b, a) @ x + weights[at + a * b : at + a * b + b]
        at += a * b + b
        x = np.tanh(x) if i < len(spec.hidden) else x
    return float(x[0])


def test_a_model_that_runs_away_is_said_to_diverge(data: Prepared) -> None:
    # GIVEN a network that adds a little to its last output, very good one step ahead
    spec = replace(spec_of(data, FEW[0]), lags=1, hidden=(1,))
    narrow = 0.01  # of tanh, almost linear there
    weights = np.array([0.0, 0.0, narrow, 0.0, 1.05 / narrow, 0.01])
    found = figures(data, spec, weights)
    assert found["one_step"]["test"]["enabled"]["r"] > 0.98
    assert found["diverged"]
    assert found["stuck_share"] > 0.1


@pytest.mark.parametrize("candidate", [FEW[0], *FEW[2:]], ids=lambda c: c.algorithm)
def test_every_algorithm_learns_reproducibly(data: Prepared, candidate: ModelCandidate) -> None:
    job = Job(candidate, 7, 40)
    one, two = train_one(data, job), train_one(data, job)
    assert one == two
    assert 0 < one["iterations"] <= 40
    assert one["one_step"]["validate"]["enabled"]["r"] > 0.8


def test_the_best_model_is_tuned(data: Prepared, result: dict[str, Any], folder: Path) -> None:
    (tuned,) = result["tuned"]
    assert tuned["number"] == result["ranking"][0]
    network = (stored(folder / f"{tuned['weights_key']}.json") or {})["network"]
    spec, weights = spec_from(network["spec"]), np.array(network["weights"])
    assert spec.lags == FEW[tuned["number"] - 1].lags
    model = result["models"][tuned["number"] - 1]
    before = model["starts"][model["best_start"]]["validation_score"]
    lower = blocks_of(data, spec).score(weights) < before * (1 - 1e-4)  # rounded to five digits
    assert lower == (tuned["stage"] != "none")


def test_the_section_shows_every_model_and_says_which_coincide(result: dict[str, Any]) -> None:
    html = section("narx", {"narx": json.loads(json.dumps(result))})
    text = html.replace("\N{NO-BREAK SPACE}", " ").replace("\N{NON-BREAKING HYPHEN}", "-")
    for model in result["models"]:
        assert f"<td>{model['number']}  {model['name']}" in text
    assert "same training as 1" in text
    assert html.count('<figure class="plots">') == 1
    assert "recordings of real engines" in html
    assert "simulated recordings" in section("narx", {"narx": {**result, "source": "simulated"}})


def test_too_few_samples_are_refused(data: Prepared, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"training samples for \d+ weights"):
        compared(data, tmp_path, SETTINGS, [ModelCandidate(1, LM, 8, (60, 60))])


def numbers(train: float, test: float, free: float, weights: int = 400) -> dict[str, Any]:
    """A model as the study stores it, from RMSE values; three starts 1 % apart."""

    def parts(k: float, *rmse: float) -> dict[str, Any]:
        values = [{"enabled": {"r": 0.9, "mse": (k * e) ** 2}} for e in rmse]
        return dict(zip(("train", "validate", "test"), values, strict=True))

    starts = [
        {
            "one_step": parts(k, train, train, test),
            "free_run": parts(k, free, free, free),
            "diverged": False,
            "unfinished": False,
        }
        for k in (0.99, 1.0, 1.01)
    ]
    return {"starts": starts, "n_weights": weights}


def test_over_and_underfitting_follow_from_the_numbers() -> None:
    models = [
        numbers(0.095, 0.114, 0.2, weights=50),  # the test blocks are a fifth harder
        numbers(0.090, 0.110, 0.2),
        numbers(0.080, 0.200, 0.2),  # learnt by heart
        numbers(0.150, 0.170, 0.2),  # learnt too little
        numbers(0.085, 0.100, 0.9),  # good one step ahead only
    ]
    labels = judge(models)
    assert labels == [[], [], ["overfits"], ["underfits"], ["one-step deceives"]]


def test_a_gap_within_the_spread_over_the_starts_is_not_called_overfitting() -> None:
    wide = numbers(0.1, 0.14, 0.2)
    for start, k in zip(wide["starts"], (0.5, 1.0, 1.5), strict=True):
        start["one_step"]["test"]["enabled"]["mse"] *= k**2
    assert judge([numbers(0.1, 0.12, 0.2, weights=50), wide])[1] == []


# Its jobs


def test_a_finished_job_is_not_repeated_and_other_settings_are(
    data: Prepared, result: dict[str, Any], folder: Path
) -> None:
    before = {p: p.stat().st_mtime_ns for p in folder.iterdir()}
    again = compared(data, folder, SETTINGS, FEW, jobs=1)
    assert {p: p.stat().st_mtime_ns for p in folder.iterdir()} == before
    assert again == result
    compared(data, folder, replace(SETTINGS, iterations=3, starts=1), FEW, jobs=1)
    assert len(list(folder.iterdir())) > len(before)


def test_a_half_written_job_does_not_count_as_finished(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"x": 1')
    assert stored(tmp_path / "a.json") is None
