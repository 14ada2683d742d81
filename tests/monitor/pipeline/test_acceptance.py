"""What the shipped model and the shipped settings must reach, on simulated drives of their own."""

import numpy as np
import pytest

from monitor.base import config
from monitor.base.types import SampleBlock
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.recordings import recording_of_samples
from tests.helpers.drives.simulated_drives import sampled
from training.dyno.simulation import Experiment
from training.limits.judging import RecordingJudge, judge_recordings
from training.recordings import metrics

Drives = list[tuple[SampleBlock, tuple[str, ...]]]

HEALTHY_SEEDS = range(70_000, 70_006)
COLD_START_ALLOWED = 1  # of the six drives one may stay unjudged
MODEL, SETTINGS = Model.load(shipped_model()), config.load()
LIMITS = Limits.from_card(MODEL.card, SETTINGS, "shipped")


@pytest.fixture(scope="module")
def drives() -> Drives:
    """Give healthy drives of the WLTC that no training saw."""
    return [sampled(Experiment(seed=seed)) for seed in HEALTHY_SEEDS]


def test_the_model_follows_an_unseen_wltc(drives: Drives) -> None:
    drive = recording_of_samples(*drives[0])
    found = judge_recordings([drive], MODEL, LIMITS, SETTINGS)[0]
    on = found.enabled
    assert on.sum() > 5000
    measured, predicted = drive.column("lambda_measured")[on], found.predicted[on]
    assert metrics.correlation(measured, predicted) >= 0.95
    assert metrics.rmse(measured, predicted) <= 0.01
    assert 0.95 <= metrics.slope(measured, predicted) <= 1.05


def test_predictions_forget_their_history_within_fifty_samples(drives: Drives) -> None:
    # GIVEN forty stretches of an unseen drive, each begun from sixteen histories of phi
    block, names = drives[1]
    model = Model.load(shipped_model(), batch=16)
    card, rng = model.card, np.random.default_rng(7)
    u = block.values[:, [names.index(name) for name in card.input_names]]
    for first in rng.integers(0, len(u) - 51, 40):
        model.reset(np.repeat(u[first : first + 1], 16, axis=0), 1.0)
        history = model.state[:, card.state.output_slice]
        history[:] = rng.uniform(0.0, 1.7, history.shape)
        history[:2] = [[0.0], [1.7]]
        # WHEN all see the same fifty samples
        for row in u[first + 1 : first + 51]:
            predicted = model.step_batch(np.repeat(row[None], 16, axis=0))
        assert np.ptp(1.0 / predicted) <= 0.01


def test_healthy_drives_of_many_seeds_get_no_code_and_are_judged(drives: Drives) -> None:
    blocks, (names, *_) = zip(*drives, strict=True)
    results = RecordingJudge(names, MODEL, LIMITS, SETTINGS).judge(blocks)
    assert [each.dtcs for each in results] == [[]] * len(HEALTHY_SEEDS)
    assert sum(not each.completed for each in results) <= COLD_START_ALLOWED
