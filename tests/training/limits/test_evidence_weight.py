"""The weight of evidence that healthy recordings allow."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base import config
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.model.card import Limit
from monitor.model.step import Model
from monitor.pipeline.replay import set_up, shipped_model
from training.limits.judging import judge_recordings
from training.limits.response import response_limits as rules
from training.recordings.recording import Recording, load

LOG = "replay_logs/healthy_micro_trips_v102_s102.blf"
CONFIG = config.load()
LIMITS: Limits = set_up(None, (), CONFIG).limits
MODEL = Model.load(shipped_model())


def limits_of(drives: list[Recording], own: Limits = LIMITS) -> dict[str, Limit]:
    judged = judge_recordings(drives, MODEL, NO_LIMITS, CONFIG)
    return rules.response_limits(judged, MODEL.card, own, CONFIG)


def test_a_bet_on_a_fault_does_not_win_on_healthy_drives() -> None:
    # GIVEN what windows say for a fault in drives of three lengths, now and then much
    rng = np.random.default_rng(7)
    drives = [rng.standard_t(3, n) - 1.0 for n in (20, 200, 2000)]
    most = CONFIG.response.evidence_window
    # WHEN the weight is set
    weight = rules.weight_of(drives, most)
    # THEN a stake that grows by each window's weighted odds is as large as before on average
    assert weight > 0.0
    assert np.exp(weight * np.concatenate([[most], *drives])).mean() == pytest.approx(1.0)
    # and few windows allow less than many, for a window may be imagined that speaks for a fault
    assert rules.weight_of(drives[:1], most) < weight
    # THEN drives that speak for a fault on average leave no weight
    assert rules.weight_of([-each for each in drives], most) == rules.LEAST_EVIDENCE


def test_drives_that_the_model_follows_badly_lower_the_weight() -> None:
    # GIVEN a healthy drive that the model follows well, and one with an injector that nobody knows
    drive = load(LOG, period_s=0.1)
    values = drive.values.copy()
    fuel = values[:, drive.names.index("fuel_mass_mg")]
    fuel *= 1.0 + 0.2 * np.sin(np.arange(len(fuel)) / 10.0)
    strange = replace(drive, values=values)
    # WHEN limits are set by the first alone, and by both
    followed = limits_of([drive])
    both = limits_of([drive, strange])
    # THEN evidence counts for less
    assert both["evidence"].value < followed["evidence"].value


def test_drives_without_windows_say_nothing_of_gains_and_evidence() -> None:
    # GIVEN a drive, and three that are over before the engine is warm
    drive = load(LOG, period_s=0.1)
    short = drive.part(0, 100)
    # WHEN the limits are set THEN they are those of the drive alone
    assert limits_of([drive, short, short, short]) == limits_of([drive])


def test_an_earlier_calibration_does_not_change_the_next_one() -> None:
    # GIVEN a card that an earlier calibration gave little weight and long stillness
    drive = load(LOG, period_s=0.1)
    earlier = replace(LIMITS, evidence=0.1, still_s=100.0, still_end_s=100.0)
    # WHEN its limits are set anew THEN they are those of a card without any
    assert limits_of([drive] * 2, earlier) == limits_of([drive] * 2)
