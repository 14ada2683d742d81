"""Limits for a chosen false-alarm rate, on simulated drives with the fault in the control loop."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from playwright.sync_api import Browser
from scipy import stats

from monitor.base import config, faults
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.bus.chromium import plots_of
from training.cli import main
from training.dyno import vehicle
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.dyno.truth import tailpipe
from training.limits.calibration import calibrate
from training.limits.judging import judge
from training.limits.paper_limits import Residuals, choose, held_out
from training.limits.tolerance import (
    cluster_bound,
    quantile_bounds,
    rate_bounds,
    tolerance_limit,
    upper_bound,
    windows_needed,
)
from training.recordings.recording import load

RATE = 0.05
WARM = vehicle.conditions(1)._replace(coolant_start_degc=85.0)
HIGHWAY = Experiment(cycle="hwfet", conditions=WARM)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    for seed in (9101, 9102, 9103, 9104, 9105):
        write(replace(HIGHWAY, seed=seed), folder, "parquet")
    for name, severity in (("slow_symmetric", 0.6), ("delay_lean_to_rich", 0.5)):
        fault = faults.resolve(name, severity)
        write(replace(HIGHWAY, seed=9106, fault=fault), folder, "parquet")
    return folder


@pytest.fixture(scope="module")
def calibrated(drives: Path) -> Path:
    """A model calibrated on the first three healthy drives and both faulty ones."""
    model = drives / "model.onnx"
    shutil.copyfile(shipped_model(), model)
    files = {"--out": "calibrated.onnx", "--json": "figures.json", "--report": "page.html"}
    written = [word for option, name in files.items() for word in (option, str(drives / name))]
    with pytest.MonkeyPatch.context() as patch:  # of seven faults in many steps, one in three
        patch.setattr(tailpipe, "SEVERITIES", {"gain_low": (0.9, 0.1)})
        patch.setattr(tailpipe, "STEPS", 3)
        patch.setattr(tailpipe, "SETTINGS", {"gain_weak_max": ("gain_low",)})
        assert main([*command(drives), *written, "--emission-limit", "1.5"]) == 0
    return drives / "calibrated.onnx"


def command(folder: Path, healthy: int = 3, rate: float = RATE) -> list[str]:
    sound = map(str, sorted(folder.glob("*_healthy.parquet"))[:healthy])
    faulty = map(str, sorted(folder.glob("*_s9106_*.parquet")))
    given = ["--model", str(folder / "model.onnx"), "--false-alarms", str(rate)]
    return ["calibrate", *given, "--healthy", *sound, "--faulty", *faulty]


def test_the_windows_of_a_calibration_are_drawn(
    drives: Path, calibrated: Path, browser: Browser
) -> None:
    assert plots_of(browser, drives / "page.html") == 1


def test_bounds_of_a_quantile_hold_it_as_often_as_they_say() -> None:
    rng, true = np.random.default_rng(3), stats.norm.ppf(0.9)
    held = 0
    for _ in range(400):
        low, high = quantile_bounds(rng.standard_normal(200), 0.9)
        assert low is not None and high is not None
        held += low <= true <= high
    assert held >= stats.binom.ppf(0.005, 400, 0.95)


def test_a_quantile_of_few_values_has_no_bounds() -> None:
    assert quantile_bounds(np.arange(20.0), 0.99) == (18.0, None)
    assert quantile_bounds([1.0, 2.0, 3.0], 0.1) == (None, 3.0)
    assert quantile_bounds([5.0], 0.5) == (None, None)


def test_the_false_alarm_rate_holds_on_drives_that_set_no_limit(
    drives: Path, calibrated: Path
) -> None:
    model, settings = Model.load(calibrated), config.load()
    limits = Limits.from_card(model.card, settings, str(calibrated))
    alarms = windows = 0
    for path in sorted(drives.glob("*_healthy.parquet"))[3:]:
        judged = judge(load(path, period_s=0.1), model, limits, settings).windows
        windows += len(judged)
        alarms += sum(w.paper_failed for w in judged)
    assert windows > 100
    assert alarms <= stats.binom.ppf(0.999, windows, RATE)


def test_false_alarms_on_drives_said_to_be_healthy_stand_beside_what_the_limits_state(
    drives: Path, calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN two drives with a sound sensor and one with a late one WHEN all are said to be healthy
    sound = [str(path) for path in sorted(drives.glob("*_healthy.parquet"))[3:]]
    late = str(next(drives.glob("*_delay_lean_to_rich*.parquet")))
    figures = drives / "evaluated.json"
    options = ["--model", str(calibrated), "--healthy", "--json", str(figures)]
    assert main(["evaluate", *sound, late, *options]) == 0
    # THEN the late one alone is a false alarm, and the rate that three drives can prove is said
    found = json.loads(figures.read_text())["false_alarms"]
    assert (found["events"], found["trials"], found["completed"]) == (1, 3, 3)
    assert found["named"] == {late: ["delay_lean_to_rich"]}
    assert found["stated"] < found["provable"] == 0.25
    out = capsys.readouterr().out
    assert "1 of 3 (95 %: 0.8 to 90.6 %), stated are at most 0.001 % of drives" in out
    assert "3 drives prove no less than 25.0 %" in out


def test_faulty_sensors_are_found_and_the_figures_say_so(drives: Path, calibrated: Path) -> None:
    result = json.loads((drives / "figures.json").read_text())
    rows = {row["fault"]: row for row in result["faulty"]}
    model, settings = Model.load(calibrated), config.load()
    limits = Limits.from_card(model.card, settings, str(calibrated))
    for name, code in (("slow_symmetric", "P0133"), ("delay_lean_to_rich", "P015B")):
        row = rows[name]
        path = drives / row["recording"]
        own = judge(load(path, period_s=0.1), model, limits, settings).windows
        assert row["paper_failed"] == sum(w.paper_failed for w in own)
        assert row["share"] > 0.8
        assert row["share_low"] < row["share"] <= row["share_high"]
        assert code in row["codes"]
    own, found = result["monitor"]["healthy"], result["monitor"]["faulty"]
    assert own["with_code"] == 0 < own["high"] < 1
    assert own["largest_evidence"] == max(row["evidence"] for row in result["healthy"])
    assert found["with_code"] == found["drives"] == len(result["faulty"]) >= found["named"] > 0
    assert result["detection"]["failed"] == sum(row["paper_failed"] for row in result["faulty"])
    assert result["false_alarms"]["bound"] <= RATE
    assert result["false_alarms"]["bound_drives"] <= RATE


def test_only_limits_and_trust_of_the_file_change(drives: Path, calibrated: Path) -> None:
    before, after = (onnx.load(str(p)) for p in (drives / "model.onnx", calibrated))
    assert before.graph.SerializeToString() == after.graph.SerializeToString()
    old, new = (Model.load(p).card for p in (drives / "model.onnx", calibrated))
    assert replace(new, limits=old.limits, trust=old.trust) == old
    assert new.limits["j_mu"] != old.limits["j_mu"]
    assert new.limits.keys() == old.limits.keys() | {
        "evidence",
        "gain_model",
    }  # older cards lack them
    assert 0.0 < new.limits["evidence"].value <= 1.0


def test_the_card_says_where_its_limits_come_from(drives: Path, calibrated: Path) -> None:
    card = Model.load(calibrated).card
    result = json.loads((drives / "figures.json").read_text())
    f = result["false_alarms"]
    for name in ("j_mu", "j_sigma"):
        origin = card.limits[name].origin
        assert "at most 0.05 false alarms per window" in origin
        assert f"{f['alarms']} of {f['windows']} healthy windows of 3 drives" in origin
        assert f"{result['detection']['windows']} windows of 2 limit-fault drives" in origin
        assert f"{f['bound']:.3g} with 95 % confidence" in origin
        assert f"{f['bound_drives']:.3g} drawing whole drives" in origin
    assert {x["name"]: x["value"] for x in result["limits"]} == {
        name: limit.value for name, limit in card.limits.items()
    }


def test_the_page_calls_simulated_drives_simulated(drives: Path, calibrated: Path) -> None:
    text = (drives / "page.html").read_text()
    assert text.count("healthy.parquet (simulated)") == 3
    assert "slow_symmetric 0.6" in text
    assert "delay_lean_to_rich 0.5" in text
    weak = json.loads((drives / "figures.json").read_text())["emissions"]["response"]
    assert f"gain_weak_max = {weak['gain_weak_max']:g}" in text and "simulated car" in text


def test_healthy_drives_alone_set_each_limit_for_the_rate(drives: Path) -> None:
    paths = sorted(drives.glob("*_healthy.parquet"))[:3]
    recordings = [load(path, period_s=0.1) for path in paths]
    settings = config.load()
    card, result = calibrate(shipped_model(), recordings, [], RATE, settings)
    seen = [row for row in result["healthy"] for _ in row["mean"]]
    means = np.concatenate([np.abs(row["mean"]) for row in result["healthy"]])
    stds = np.concatenate([row["std"] for row in result["healthy"]])
    for name, values in (("j_mu", means), ("j_sigma", stds)):
        limit = card.limits[name].value * (1.0 + 1e-4)  # the figures have five digits
        alarms = int((values >= limit).sum())
        assert alarms > 0
        assert upper_bound(alarms, len(seen)) <= RATE
    assert result["detection"] is None
    assert any("3 healthy drives with windows" in text for text in result["warnings"])


def test_a_drive_that_the_model_was_trained_on_is_told(drives: Path) -> None:
    path = sorted(drives.glob("*_healthy.parquet"))[1]
    known = Model.load(shipped_model()).card.recordings[0].sha256
    recording = replace(load(path, period_s=0.1), sha256=known)
    _, result = calibrate(shipped_model(), [recording], [], RATE, config.load())
    assert any("the model was trained on it" in text for text in result["warnings"])


def test_too_few_windows_are_refused_and_the_model_stays(
    drives: Path, calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (drives / "model.onnx").read_bytes()
    assert main(command(drives, healthy=1, rate=0.001)) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "healthy windows, 5191 are wanted" in error
    assert (drives / "model.onnx").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--false-alarms", "0"], "wanted more than 0"),
        (["--false-alarms", "nan"], "wanted more than 0"),
        (["--healthy", "{faulty}"], "given as healthy, its manifest says slow_symmetric"),
        (["--faulty", "{healthy}"], "the same as"),
        (["--faulty", "{other}"], "given as faulty, its manifest says healthy"),
        (["--out", "{folder}/model.txt"], "ends in .onnx"),
        (["--report", "{folder}/no/page.html"], "the folder does not exist"),
        (["--model", "{folder}/none.onnx"], "none.onnx"),
        (["--emission-limit", "1"], "more than 1 is wanted"),
    ],
)
def test_what_cannot_be_is_one_line(
    change: list[str],
    message: str,
    drives: Path,
    calibrated: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = {
        "faulty": drives / "hwfet_v1_s9106_slow_symmetric.parquet",
        "healthy": drives / "hwfet_v1_s9101_healthy.parquet",
        "other": drives / "hwfet_v1_s9105_healthy.parquet",
        "folder": drives,
    }
    assert main([*command(drives), *(each.format(**files) for each in change)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


# The statistics, on distributions that no formula here assumes


def test_a_limit_proves_its_rate_in_nineteen_calibrations_of_twenty() -> None:
    rng = np.random.default_rng(11)
    n, runs = 200, 400
    alone = np.arange(n)  # every window a drive of its own
    true = [
        stats.lognorm.sf(tolerance_limit(rng.lognormal(0.0, 1.5, n), alone, RATE), 1.5)
        for _ in range(runs)
    ]
    beyond = int(np.sum(np.array(true) > RATE))
    assert beyond <= stats.binom.ppf(0.999, runs, 0.05)
    assert np.median(true) > 0.4 * RATE  # and it is no wider than need be


def residuals(rng: np.random.Generator, n: int, spread: float) -> Residuals:
    mean = spread * 0.004 * rng.standard_t(5, n)
    std = spread * 0.005 * rng.gamma(6.0, 1 / 6, n) + 0.3 * np.abs(mean)
    return Residuals(mean, std, np.arange(n))


def test_choosing_the_pair_does_not_spoil_its_confidence() -> None:
    rng = np.random.default_rng(12)
    many = residuals(rng, 100_000, 1.0)
    runs = 120
    true = []
    for _ in range(runs):
        chosen = choose(residuals(rng, 300, 1.0), residuals(rng, 100, 1.6), RATE)
        true.append(many.failed(chosen.j_mu, chosen.j_sigma).mean())
    assert int(np.sum(np.array(true) > RATE)) <= stats.binom.ppf(0.999, runs, 0.05)


def test_the_pair_misses_fewer_than_each_limit_alone() -> None:
    rng = np.random.default_rng(13)
    healthy, faulty = residuals(rng, 400, 1.0), residuals(rng, 400, 2.0)
    pair, alone = choose(healthy, faulty, RATE), choose(healthy, None, RATE)
    found = [int(faulty.failed(x.j_mu, x.j_sigma).sum()) for x in (pair, alone)]
    assert found[0] > found[1]


def test_alarms_of_one_odd_drive_widen_the_bound_and_the_limit() -> None:
    # GIVEN ten drives of forty windows, one of them with most of the large scores
    rng = np.random.default_rng(14)
    scores = rng.gamma(4.0, 1.0, (10, 40))
    scores[3] *= 2.0
    drive = np.repeat(np.arange(10), 40)
    alone = np.arange(400)
    # WHEN whole drives are drawn, not windows
    limit, narrow = (tolerance_limit(scores.ravel(), d, RATE) for d in (drive, alone))
    # THEN the same alarms prove less, and the limit is higher
    alarms = scores.ravel() >= narrow
    assert cluster_bound(alarms, drive) > RATE >= cluster_bound(alarms, alone)
    assert limit > narrow
    assert cluster_bound(scores.ravel() >= limit, drive) <= RATE


def test_limits_without_the_drive_in_question_are_those_of_the_other_drives() -> None:
    # GIVEN an odd healthy drive, which cannot excuse itself
    rng = np.random.default_rng(15)
    healthy = residuals(rng, 600, 1.0)
    odd = np.arange(600) >= 500
    healthy = Residuals(
        np.where(odd, 2.0, 1.0) * healthy.mean,
        np.where(odd, 2.0, 1.0) * healthy.std,
        np.arange(600) // 100,
    )
    faulty = replace(residuals(rng, 200, 2.0), drive=np.arange(200) // 100)
    # WHEN limits are set without it
    alarms, found = held_out(healthy, faulty, RATE)
    without = choose(healthy.of(~odd), faulty, RATE)
    own = healthy.of(odd).failed(without.j_mu, without.j_sigma)
    # THEN its windows alarm as the other drives' limits say, more than in the fit
    assert alarms is not None
    assert found is not None
    assert alarms >= own.sum() > RATE * 100
    assert alarms > choose(healthy, faulty, RATE).alarms
    assert 0 < found < 200
    assert held_out(healthy.of(odd), None, RATE) == (None, None)


@pytest.mark.parametrize("rate", [0.2, 0.05, 0.01, 0.001])
def test_the_windows_needed_are_the_fewest_that_prove_the_rate(rate: float) -> None:
    n = windows_needed(rate)
    assert upper_bound(0, n) <= rate < upper_bound(0, n - 1)


def test_bounds_of_a_rate_are_those_of_the_exact_test() -> None:
    for k, n in ((0, 30), (3, 30), (30, 30)):
        exact = stats.binomtest(k, n).proportion_ci(0.95, method="exact")
        assert rate_bounds(k, n) == pytest.approx((exact.low, exact.high), abs=1e-6)
