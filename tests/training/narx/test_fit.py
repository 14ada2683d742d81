"""Training as a whole: a small fit, its report and its evaluation."""

import json
import re
from dataclasses import replace
from itertools import count
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from playwright.sync_api import Browser

from monitor.base.errors import ModelError, RecordingError, UsageError
from monitor.base.types import Quality
from monitor.model.step import Model
from tests.helpers.bus.chromium import plots_of
from tests.helpers.drives.recordings import recording_of
from training.cli import main
from training.limits.evaluation import evaluate
from training.narx.fit import FitOptions, FitResult, FitSource, fit
from training.narx.network import Spec, layers
from training.narx.page.fit_verdict import fit_confidence, fit_verdict
from training.narx.page.free_run_figures import measured_blocks
from training.narx.page.training_page import write_report
from training.narx.search.stability import contraction
from training.narx.search.stages import Trained, with_less_feedback
from training.narx.work import PER_MINUTE, Work, of_epoch
from training.recordings.prediction import predict
from training.recordings.recording import Recording, write_table

NAMES = ("air_mass_mg", "fuel_mass_mg", "lambda_measured", "fuel_cut")


def plant(seed: int, n: int = 2500) -> Recording:
    """A mixture behind a dead time and a sensor lag, with fuel cuts, 10 Hz."""
    rng = np.random.default_rng(seed)
    hold = np.searchsorted(np.cumsum(rng.integers(5, 50, n)), np.arange(n), side="right")
    air = rng.uniform(100, 500, n)[hold]
    mixture = (1.0 + 0.05 * rng.standard_normal(n))[hold]
    cut = (rng.uniform(size=n)[hold] < 0.08).astype(float)
    fuel = air / 14.7 * mixture * (1.0 - cut)
    phi = np.ones(n)
    for t in range(3, n):
        phi[t] = phi[t - 1] + 0.45 * (14.7 * fuel[t - 2] / air[t - 2] - phi[t - 1])
    measured = 1.0 / np.maximum(phi + 0.002 * rng.standard_normal(n), 1 / 16)
    measured[:7] = np.nan  # the sensor is not ready yet
    columns = dict(zip(NAMES, (air, fuel, measured, cut), strict=True))
    return recording_of(columns, f"drive{seed}.csv", sha256=f"{seed:064x}")


def source_of(*recordings: Recording) -> FitSource:
    return FitSource(recordings, NAMES[:2], NAMES[2])


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    out = tmp_path_factory.mktemp("fit") / "model.onnx"
    source = source_of(plant(1), plant(2))
    options = FitOptions(lags=3, hidden=(5,), starts=2, budget_minutes=1.0, seed=3)
    return fit(source, out, options)


def test_a_small_plant_is_learned_in_free_run(fitted: FitResult) -> None:
    figures = fitted.card.fit["test_enabled"]
    assert figures["correlation"] > 0.97
    assert figures["rmse_model_units"] < 0.01
    assert fitted.seconds < 60


def test_the_file_holds_what_the_fit_says(fitted: FitResult) -> None:
    card = Model.load(fitted.path).card
    assert card == fitted.card
    assert (card.input_names, card.transform) == (NAMES[:2], "phi")
    assert [r.sha256 for r in card.recordings] == [f"{1:064x}", f"{2:064x}"]
    assert card.checks["contraction"]["gap"] < 0.01


def test_twins_measure_a_fit_on_all_of_its_recordings(fitted: FitResult) -> None:
    found = measured_blocks(fitted.data)
    assert {segment.recording for segment, _, _ in found} == {0, 1}
    measured = sum(stop - first for _, first, stop in found)
    assert measured == np.isfinite(fitted.predicted).sum() > 0.99 * len(fitted.data.role)


def test_the_best_stage_is_the_one_with_the_best_free_run(fitted: FitResult) -> None:
    best = fitted.chosen.model
    assert best.score == min(min(stage.scores) for stage in best.stages)
    assert [s.name for s in best.stages] == [f"horizon {h}" for h in (1, 20, 100, 1000)]


def test_a_loop_so_unstable_that_no_step_helps_forgets_in_the_end(fitted: FitResult) -> None:
    data = source_of(plant(1), plant(2)).prepared(3, 3)
    # GIVEN weights whose prediction hangs on its own past ten times as much
    best = fitted.chosen.model
    spec, weights = best.spec, best.weights.copy()
    layers(spec, weights)[0][0][:, -spec.lags :] *= 10.0
    layers(spec, weights)[1][0][:] *= 2.0
    assert contraction(data, spec, weights, 0).gap > 1.0
    # WHEN the feedback is taken back THEN the model forgets and predicts
    start = Trained(spec, weights, np.inf)
    trained = with_less_feedback(data, start, 1, Work())
    assert contraction(data, spec, trained.weights, 0).gap < 0.01
    assert trained.score < 0.1  # standard deviations of the output
    # AND without work left it forgets at least
    trained = with_less_feedback(data, start, 1, Work(0.0))
    assert contraction(data, spec, trained.weights, 0).gap < 0.01


def test_evaluate_scores_free_run_and_one_step_after_the_washout(fitted: FitResult) -> None:
    drive = plant(9)
    result = evaluate(fitted.path, [drive])
    assert result["schema"] == "o2train.evaluate/1"
    (figures,) = result["recordings"]
    named = {"path", "samples", "rmse", "fit_percent", "correlation", "one_step_rmse"}
    assert named <= set(figures)
    assert figures["path"] == "drive9.csv"
    assert figures["samples"] == 2500 - 7 - 3  # not ready, then the longest lag
    assert figures["enabled"]["samples"] < figures["samples"]
    assert figures["enabled"]["correlation"] > 0.97
    json.dumps(result, allow_nan=False)
    longer = evaluate(fitted.path, [drive], washout=50)["recordings"][0]
    assert longer["samples"] == 2500 - 7 - 50


def test_without_conditions_the_samples_that_are_judged_are_enabled(fitted: FitResult) -> None:
    drive = plant(9)
    bare = replace(drive, names=NAMES[:3], values=drive.values[:, :3], quality=drive.quality[:, :3])
    (found,) = evaluate(fitted.path, [bare])["recordings"]
    assert 2000 < found["enabled"]["samples"] <= found["samples"]


def test_the_free_run_of_evaluate_is_that_of_the_model_alone(fitted: FitResult) -> None:
    drive, model = plant(9), Model.load(fitted.path)
    _, free, _, _ = predict(model, drive, 3)
    u, y = drive.values[7:, :2], drive.values[7:, 2]
    model.reset(u[0], y[0])
    for t, predicted in enumerate(free[7:]):
        assert model.step(u[t]) == predicted
        if t < 3:
            model.force_output(y[t])


def test_a_gap_in_the_inputs_restarts_the_free_run(fitted: FitResult) -> None:
    drive = plant(9)
    drive.values[1000:1010, 0] = np.nan
    # AND a reading at the end of the sensor's range is none, unless fuel is cut
    drive.values[2000:2020, 3] = np.arange(20) % 2
    drive.quality[2000:2020, 2] = Quality.PINNED
    figures = evaluate(fitted.path, [drive])["recordings"][0]
    assert figures["samples"] == 2500 - 7 - 10 - 2 * 3 - 10


def test_a_recording_that_does_not_fit_the_model_is_named(fitted: FitResult) -> None:
    drive = plant(9)
    slow = replace(drive, period_ns=200_000_000)
    with pytest.raises(RecordingError, match=r"drive9\.csv: sample period 0\.2 s"):
        evaluate(fitted.path, [slow])
    with pytest.raises(ModelError, match="no such model file"):
        evaluate(fitted.path.with_name("other.onnx"), [drive])


def test_too_few_samples_for_the_weights_are_refused_and_few_are_warned_of(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"training samples for \d+ weights are too few"):
        fit(source_of(plant(1, 300)), tmp_path / "m.onnx", FitOptions(hidden=(20, 20)))
    options = FitOptions(hidden=(18,), starts=1, budget_minutes=0.01)  # 307 weights, 6/7 of 400
    result = fit(source_of(plant(1, 400)), tmp_path / "m.onnx", options)
    assert any("expect overfitting" in w for w in result.warnings)


def test_the_budget_of_work_ends_the_training_with_the_best_so_far(tmp_path: Path) -> None:
    # GIVEN a budget of a few epochs WHEN a network is trained
    epoch = of_epoch(1800, Spec(2, 5, (4,)).n_weights)
    options = FitOptions(hidden=(4,), starts=2, budget_minutes=40 * epoch / PER_MINUTE)
    result = fit(source_of(plant(1)), tmp_path / "m.onnx", options)
    # THEN the work stays within it but for the last epochs, and the fit says that it was cut
    counted = result.card.checks["work"]
    assert counted["counted"] <= 40 * epoch
    assert not counted["ended_by_wall"]
    assert any("budget ended" in w for w in result.warnings)
    with pytest.raises(UsageError, match="ended before the first epoch"):
        fit(source_of(plant(1)), tmp_path / "m.onnx", FitOptions(hidden=(4,), budget_minutes=1e-9))


@pytest.mark.parametrize("minutes", [0.002, 0.01])
def test_a_search_never_takes_more_work_than_the_budget(tmp_path: Path, minutes: float) -> None:
    # GIVEN a budget that ends in the first or in a later candidate
    options = FitOptions(budget_minutes=minutes, threads=1)
    # WHEN structures are searched THEN the work stays within it, and there is a model
    card = fit(source_of(plant(1)), tmp_path / "m.onnx", options).card
    assert 0.3 * minutes < card.checks["work"]["counted"] / PER_MINUTE <= minutes
    assert np.isfinite(card.fit["test"]["rmse"])


def test_a_wall_limit_that_ends_a_fit_early_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a clock that goes on by a second whenever it is read
    monkeypatch.setattr("training.narx.work.time.monotonic", map(float, count()).__next__)
    options = FitOptions(hidden=(4,), starts=1, threads=1, wall_minutes=0.5)
    # WHEN the fit runs into its wall limit of 30 s
    result = fit(source_of(plant(1)), tmp_path / "m.onnx", options)
    # THEN the card and the warnings say so
    assert Model.load(result.path).card.checks["work"]["ended_by_wall"]
    assert any("wall limit ended the training early" in w for w in result.warnings)
    assert any("the wall limit ended 1 of 1 starts" in w for w in result.warnings)
    # AND no twin was left time to, which measures the model and sets its limits
    assert result.healthy()[1].endswith("too little or too briefly for twins")
    assert "Give more recordings or work" in fit_verdict(result.card)[0]
    # AND one that passes before the search begins is an error that says so
    with pytest.raises(UsageError, match="the wall limit ended before the first epoch"):
        fit(source_of(plant(1)), tmp_path / "m.onnx", FitOptions(wall_minutes=1e-9))


def test_fits_beside_other_work_write_the_same_file(tmp_path: Path) -> None:
    # GIVEN a fit that its budget ends
    options = FitOptions(budget_minutes=0.001, seed=2)
    source = source_of(plant(1, 600))
    fit(source, tmp_path / "alone.onnx", options)
    # WHEN the same runs beside threads that keep every core busy
    stop = Event()

    def busy() -> None:
        block = np.ones((400, 400))
        while not stop.is_set():
            block @ block

    others = [Thread(target=busy) for _ in range(2)]
    for other in others:
        other.start()
    try:
        fit(source, tmp_path / "beside.onnx", options)
    finally:
        stop.set()
        for other in others:
            other.join()
    # THEN both files are equal, byte by byte
    assert (tmp_path / "alone.onnx").read_bytes() == (tmp_path / "beside.onnx").read_bytes()


@pytest.mark.parametrize(
    ("correlation", "found", "kind", "says"),
    [
        (0.95, {}, "good", "The model follows"),
        (0.7, {}, "", "in part"),
        (0.3, {}, "bad", "too little"),
        (0.3, {"gain_low": 4, "transient": 3}, "good", "can judge its vehicle: tried on 4 drives"),
        (0.3, {"gain_low": 4, "transient": 1}, "", "in part: .* finds 1 of 2 faults"),
        (0.3, {"gain_low": 1, "transient": 1}, "bad", "too little"),
    ],
)
def test_a_model_is_judged_by_what_it_found_on_unseen_drives_and_else_by_its_correlation(
    fitted: FitResult, correlation: float, found: dict[str, int], kind: str, says: str
) -> None:
    figures = dict(fitted.card.fit["test_enabled"], correlation=correlation)
    trust = {"drives": 4, "found": found, "false": {}} if found else {}
    card = replace(fitted.card, trust=trust, fit={**fitted.card.fit, "test_enabled": figures})
    verdict, of_kind = fit_verdict(card)
    assert of_kind == kind and re.search(says, verdict)


def test_the_confidence_in_a_verdict_is_of_its_samples(fitted: FitResult) -> None:
    data = replace(fitted.data, enabled=np.arange(len(fitted.predicted)) % 3 > 0)
    wrong = np.where(data.enabled, fitted.predicted, -fitted.predicted)  # as in fuel cuts
    told = fit_confidence(replace(fitted, data=data, predicted=wrong))
    assert told == fit_confidence(replace(fitted, data=data))
    assert "in the median of" in told


def test_the_plots_of_a_fit_are_drawn(fitted: FitResult, browser: Browser, tmp_path: Path) -> None:
    write_report(tmp_path / "fit.html", fitted)
    blocks = min(len(measured_blocks(fitted.data)), 3)
    assert plots_of(browser, tmp_path / "fit.html") == 1 + blocks + 2


def test_the_report_draws_the_starts_of_a_mean_of_recordings_that_are_never_enabled(
    fitted: FitResult, tmp_path: Path
) -> None:
    # GIVEN a mean, which has no epochs itself
    starts = fitted.chosen.starts
    mean = replace(fitted.chosen.model, stages=[], members=len(starts))
    chosen = replace(fitted.chosen, starts=(*starts, mean), model=mean)
    data = replace(fitted.data, enabled=np.zeros(len(fitted.predicted), dtype=bool))
    write_report(tmp_path / "fit.html", replace(fitted, chosen=chosen, data=data))
    text = (tmp_path / "fit.html").read_text()
    assert "Free run on held-out blocks" in text
    assert f"start {len(starts)}" in text and f"start {len(starts) + 1}" not in text


def test_fit_and_evaluate_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN two drives as tables
    for seed in (1, 2):
        drive = plant(seed, 1500)
        write_table(tmp_path / f"drive{seed}.csv", drive.t_s, drive.names, drive.values)
    model = str(tmp_path / "m.onnx")
    # WHEN one is trained on and the other evaluated
    shape = ["--inputs", *NAMES[:2], "--lags", "2", "--hidden", "3", "--starts", "1"]
    written = ["--out", model, "--report", str(tmp_path / "fit.html")]
    assert main(["fit", str(tmp_path / "drive1.csv"), *shape, *written]) == 0
    assert main(["evaluate", "--model", model, str(tmp_path / "drive2.csv")]) == 0
    # THEN both say how good it is, and of what one drive tells nothing
    said = capsys.readouterr()
    assert "held out, enabled samples: free run fit" in said.out
    assert "its vehicle in part: tried on" in said.out
    assert said.err.count("one recording does not show how drives differ") == 1
    # AND a model that is missing is an error of one line
    assert main(["evaluate", "--model", "nowhere.onnx", str(tmp_path / "drive2.csv")]) == 2
    assert capsys.readouterr().err == "o2train: nowhere.onnx: no such model file\n"
