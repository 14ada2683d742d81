"""What the shipped model and the shipped settings must reach, on simulated drives of their own."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from monitor.base import config, faults
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.simulated_drives import sampled
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.limits.judging import judge
from training.limits.side_by_side import Judged, RecordingJudge
from training.recordings import metrics
from training.recordings.recording import load

HEALTHY_SEEDS = range(70_000, 70_010)
COLD_START_ALLOWED = 1  # of the ten drives one may stay unjudged
RESPONSE_FAULTS = (*faults.NAMES[:6], "gain_low", "biased_lean", "biased_rich")


def test_the_model_follows_an_unseen_wltc(tmp_path: Path) -> None:
    model = Model.load(shipped_model())
    limits = Limits.from_card(model.card, config.load(), "shipped")
    drive = load(write(Experiment(seed=71_000), tmp_path, "parquet"))
    found = judge(drive, model, limits, config.load())
    on = found.enabled
    assert on.sum() > 5000
    measured, predicted = found.measured[on], found.predicted[on]
    assert metrics.correlation(measured, predicted) >= 0.95
    assert metrics.rmse(measured, predicted) <= 0.01
    assert 0.95 <= metrics.slope(measured, predicted) <= 1.05


def test_predictions_forget_their_history_within_fifty_samples(tmp_path: Path) -> None:
    # GIVEN forty stretches of an unseen drive, each begun from sixteen histories of phi
    drive = load(write(Experiment(seed=71_001), tmp_path, "parquet"))
    model = Model.load(shipped_model(), batch=16)
    card, rng = model.card, np.random.default_rng(7)
    u = drive.values[:, [drive.names.index(name) for name in card.input_names]]
    for first in rng.integers(0, len(u) - 51, 40):
        model.reset(np.repeat(u[first : first + 1], 16, axis=0), 1.0)
        history = model.state[:, card.state.output_slice]
        history[:] = rng.uniform(0.0, 1.7, history.shape)
        history[:2] = [[0.0], [1.7]]
        # WHEN all see the same fifty samples
        for row in u[first + 1 : first + 51]:
            predicted = model.step_batch(np.repeat(row[None], 16, axis=0))
        # THEN they agree
        assert np.ptp(1.0 / predicted) <= 0.01


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load(shipped_model())


def judged(experiments: Sequence[Experiment], model: Model) -> list[Judged]:
    """Return the verdicts of the shipped settings, as one driving cycle each."""
    settings = config.load()
    limits = Limits.from_card(model.card, settings, "shipped")
    blocks, (names, *_) = zip(*map(sampled, experiments), strict=True)
    return RecordingJudge(names, model, limits, settings).judge(blocks)


def test_healthy_drives_of_many_seeds_get_no_code_and_are_judged(model: Model) -> None:
    results = judged([Experiment(seed=seed) for seed in HEALTHY_SEEDS], model)
    assert [each.dtcs for each in results] == [[]] * len(HEALTHY_SEEDS)
    assert sum(not each.completed for each in results) <= COLD_START_ALLOWED


@pytest.mark.parametrize("name", RESPONSE_FAULTS)
def test_a_faulty_sensor_in_the_loop_gets_its_code_in_the_drive(name: str, model: Model) -> None:
    drive = Experiment(vehicle=501, seed=72_000, fault=faults.resolve(name))
    (found,) = judged([drive], model)
    assert {dtc.fault for dtc in found.dtcs} == {name}
