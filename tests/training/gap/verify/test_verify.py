"""Verifying a model with an added effect: errors by regime, bounds, faults still found."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor.base import config
from monitor.base.faults import Fault, resolve
from monitor.base.types import FloatArray
from monitor.model.card import Limit
from monitor.model.step import Model
from tests.helpers.drives.recordings import recording_of
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from training.gap.add.addition import Addition
from training.gap.inputs.roles import FAULTS
from training.gap.verify.error_regimes import compare
from training.gap.verify.evidence import Count
from training.gap.verify.verification import Fold, Verification, verify
from training.gap.workflow import delivered
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.fit.drive import Comparison
from training.greybox.model import fit_greybox
from training.limits.decision_limits import with_limits
from training.narx.export import update_card
from training.recordings.recording import Recording
from training.recordings.sensor_fault import faulty_readings, put_on

NOISE = 0.001
GAIN = 1.02  # of the vehicle with the gap: the old model was fitted at 1


def recording(seed: int, gain: float = GAIN, n: int = 6000, by_speed: float = 0.0) -> Recording:
    """Return a drive of a chain with that gain; ``by_speed`` is richness per 1,000 rpm."""
    signals = plain_signals(n, seed)
    noise = lfilter([1.0], [1.0, -0.8], NOISE * np.random.default_rng([seed, 9]).normal(size=n))
    phi = simulate(base_path(Constants(gain=gain), signals), PERIOD_S) + noise
    phi += by_speed * (signals["engine_speed_rpm"] - 1900.0) / 1000.0
    columns = signals | {"lambda_measured": 1.0 / np.maximum(phi, 1.0 / 16.0)}
    return recording_of(columns, f"drive_{seed}.csv", PERIOD_S, f"{seed:064d}")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A model of the vehicle before the gap, and one that has what is missing."""
    folder = tmp_path_factory.mktemp("models")
    paths = []
    for name, gain in (("old", 1.0), ("new", GAIN)):
        drives = [recording(seed, gain) for seed in (1, 2)]
        fitted = fit_greybox(drives, folder / f"{name}.onnx")
        update_card(fitted.path, with_limits(fitted.card, *fitted.healthy(), config.load()))
        paths.append(fitted.path)
    return paths[0], paths[1]


def held_out() -> list[Recording]:
    return [recording(seed) for seed in (3, 4, 5)]


def verified(
    old: Path,
    new: Path | None,
    recordings: list[Recording],
    healthy: Sequence[Recording] = (),
    faults: Sequence[Fault] = FAULTS,
) -> Verification:
    """Return both models on recordings, each in turn as if the new one were made of the others."""
    folds = [Fold(new, [each]) for each in recordings]
    return verify(old, folds, healthy, chain=Constants(), new=new, faults=faults)


def test_a_model_with_what_was_missing_is_better_everywhere_and_still_finds_faults(
    models: tuple[Path, Path],
) -> None:
    # GIVEN drives with a gap of 0.02 in phi that no fit saw
    # WHEN both models are run on them
    found = verified(*models, held_out(), [recording(6, 1.0)])
    # THEN the gap is gone down to the noise, in every regime
    whole, noise = found.overall, NOISE / (1.0 - 0.8**2) ** 0.5
    assert whole.before == pytest.approx(0.02, rel=0.05)
    assert whole.after == pytest.approx(noise, rel=0.05)
    assert whole.floor == pytest.approx(noise, rel=0.05)
    assert found.closed is not None
    assert found.closed > 0.99
    assert {e.kind for e in found.regimes} == {
        "speed and load",
        "temperature",
        "after fuel cut",
        "edge",
    }
    assert all(e.better for e in found.regimes)
    assert found.worse == ()
    # AND the stretch that is shown has both runs
    trace = found.trace
    assert trace is not None
    off = [np.abs(trace.measured - run)[trace.scored] for run in (trace.before, trace.after)]
    assert float(off[0].mean()) > 5.0 * float(off[1].mean())
    # AND what it costs on the vehicle as it was is said beside
    assert found.healthy is not None
    assert found.healthy.after == pytest.approx(0.02, rel=0.05)
    # AND the monitor finds every fault with both, and nothing where there is none
    assert [(f.fault, f.severity) for f in found.faults] == [(f.name, f.severity) for f in FAULTS]
    assert found.rates == (1.0, 1.0)
    assert found.alarms is not None
    assert found.alarms.after == Count(3, 3, 0, 0, ())
    assert found.harm is None
    assert "the control loop has not seen them" in found.notes[0]


def test_a_regime_that_gets_worse_is_told(models: tuple[Path, Path]) -> None:
    # GIVEN a gap that is there at high speed only
    drives = [recording(seed, 1.01, by_speed=0.03) for seed in (3, 4, 5)]
    # WHEN the new model is richer everywhere
    found = verified(*models, drives, faults=())
    # THEN low speed is worse beyond confidence, high speed better
    cells = [e for e in found.regimes if e.kind == "speed and load"]
    assert [e.worse for e in cells] == [True] * 3 + [False] * 6
    assert [e.better for e in cells] == [False] * 6 + [True] * 3
    assert {e.regime for e in found.worse} == {e.regime for e in cells[:3]}


def test_without_a_new_model_there_are_the_old_figures_alone(models: tuple[Path, Path]) -> None:
    found = verified(models[0], None, held_out(), faults=FAULTS[:1])
    assert found.overall.before == pytest.approx(0.02, rel=0.05)
    assert found.overall.after is None
    assert found.closed is None
    assert all(e.change_low is None and not e.worse and not e.better for e in found.regimes)
    assert found.rates == (1.0, None)


def slow_noise(seed: int, n: int) -> FloatArray:
    return np.asarray(lfilter([1.0], [1.0, -0.95], np.random.default_rng(seed).normal(size=n)))


def test_models_that_are_equally_good_seldom_differ_beyond_confidence_anywhere() -> None:
    # GIVEN residuals of the same size, correlated over two seconds
    n, trials = 6000, 60
    signals = plain_signals(n, 4)
    scored = np.ones(n, dtype=bool)
    phi = 1.0 + 0.02 * np.sin(np.arange(n) * 0.2)
    told = 0
    for seed in range(trials):
        old, new = slow_noise(2 * seed, n), slow_noise(2 * seed + 1, n)
        drive = Comparison(
            name="drive",
            period_s=PERIOD_S,
            signals=signals,
            phi_measured=phi + old,
            phi_predicted=phi,
            scored=scored,
        )
        told += any(e.worse or e.better for e in compare([drive], [new], None)[1:])
    # THEN about one in twenty has a regime in which they differ beyond confidence
    assert told / trials <= 0.10


def test_a_fault_is_put_on_the_reading_alone() -> None:
    drive = recording(3)
    at = drive.names.index("lambda_measured")
    drive.values[100:110, at] = np.nan
    fault = resolve("slow_symmetric", 0.5)
    faulty = put_on(drive, fault)
    wanted = faulty_readings(fault, drive.values[:, at], PERIOD_S)
    np.testing.assert_array_equal(faulty.values[:, at], wanted)
    assert np.isnan(faulty.values[100:110, at]).all()
    others = [i for i in range(len(drive.names)) if i != at]
    np.testing.assert_array_equal(faulty.values[:, others], drive.values[:, others])
    assert not np.array_equal(faulty.values[:, at], drive.values[:, at], equal_nan=True)


def test_a_fault_that_the_new_model_finds_no_more_is_told(
    models: tuple[Path, Path], tmp_path: Path
) -> None:
    # GIVEN a new model whose card allows an offset of half a lambda
    blind = tmp_path / "blind.onnx"
    blind.write_bytes(models[1].read_bytes())
    card = Model.load(blind).card
    limits = dict(card.limits) | {"offset": Limit(0.5, "-", "a test")}
    update_card(blind, replace(card, limits=limits))
    # WHEN a biased sensor is put before both
    faults = [resolve("biased_lean", 0.1), resolve("delay_symmetric", 0.4)]
    found = verified(models[0], blind, held_out(), faults=faults)
    # THEN the biased one is lost, the late one not
    assert [f.lost for f in found.faults] == [True, False]
    assert found.rates == (1.0, 0.5)
    assert found.harm is not None
    assert (
        "finds a fault put on in 1 of 2 drives with the new model, in 2 with the old" in found.harm
    )
    # AND the new model is an offer, where one without loss is delivered
    told = Addition(blind, form="inside the chain", warnings=("a warning",))
    kept = delivered(told, replace(found, faults=found.faults[1:]), tmp_path)
    assert (kept.path, kept.withdrawn) == (tmp_path / "model.onnx", None)
    offered = delivered(kept, found, tmp_path)
    assert (offered.path, offered.withdrawn) == (None, found.harm)
    assert list(tmp_path.iterdir()) == [offered.offer]


def test_a_model_without_limits_is_verified_without_the_monitor(
    models: tuple[Path, Path], tmp_path: Path
) -> None:
    bare = tmp_path / "bare.onnx"
    bare.write_bytes(models[0].read_bytes())
    update_card(bare, replace(Model.load(bare).card, limits={}))
    found = verified(bare, models[1], held_out())
    assert found.overall.after is not None
    assert found.faults == ()
    assert found.rates == (None, None)
    assert "the model card has no limit" in found.notes[0]
