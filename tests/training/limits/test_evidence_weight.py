"""The weight of evidence that healthy recordings allow."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from monitor.base import config
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import set_up, shipped_model
from training.limits.response import response_limits as rules
from training.recordings.recording import load

LOG = "replay_logs/healthy_micro_trips_v102_s102.blf"
CONFIG = config.load()
LIMITS: Limits = set_up(None, (), CONFIG).limits
ALLOWED = -CONFIG.response.evidence_fail / math.log(rules.CODE_PROBABILITY)


@pytest.mark.parametrize(
    ("others", "own", "wanted"),
    [
        (0.0, 2.5, 0.75),  # all that the windows say is allowed
        (0.0, 10.0, ALLOWED / 10.0),
        (1.0001 * ALLOWED, 4.0, 0.0),  # movement alone leaves no room
    ],
)
def test_the_weight_of_evidence_is_found_in_few_steps(
    others: float, own: float, wanted: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN healthy recordings whose evidence of a fault follows the weight in part
    asked = []

    def most(_model: Any, _recordings: Any, limits: Limits, _config: Any) -> list[float]:
        asked.append(limits.evidence)
        return [others + own * limits.evidence]

    monkeypatch.setattr(rules, "_most_evidence", most)
    full = replace(LIMITS, evidence=0.75)
    # WHEN the weight is set THEN it is at most a fifth too low, and soon found
    found = rules._calmed(None, (), full, CONFIG)  # type: ignore[arg-type]
    assert 0.8 * wanted <= found.evidence <= wanted + 1e-3
    assert len(asked) < 40


def test_more_recordings_allow_a_larger_worst_one() -> None:
    # GIVEN healthy drives whose largest evidence of a fault is exponentially distributed
    rng = np.random.default_rng(7)
    drawn = [rng.exponential(1.5, size=(2000, n)) for n in (3, 10, 30)]
    # WHEN the mean is estimated from few and from many
    found = [np.array([rules._scale(row) for row in rows.tolist()]) for rows in drawn]
    # THEN it does not grow with their number, as the largest one does
    medians = [float(np.median(each)) for each in found]
    largest = [float(np.median(rows.max(axis=1))) for rows in drawn]
    assert medians == pytest.approx([1.5] * 3, abs=0.2)
    assert largest[2] > 2.0 * largest[0]
    # THEN a single odd drive among calm ones still counts
    assert rules._scale([0.1] * 9 + [12.0]) > 2.0 * np.mean([0.1] * 9 + [12.0])


def test_windows_are_bound_where_healthy_recordings_show_evidence_of_a_fault() -> None:
    # GIVEN a healthy drive that the model follows well, and one with an injector that nobody knows
    model, drive = Model.load(shipped_model()), load(LOG, period_s=0.1)
    values = drive.values.copy()
    fuel = values[:, drive.names.index("fuel_mass_mg")]
    fuel *= 1.0 + 0.2 * np.sin(np.arange(len(fuel)) / 10.0)
    # WHEN limits are set on each
    followed, strange = (
        rules.response_limits(model, [each], LIMITS, CONFIG)
        for each in (drive, replace(drive, values=values))
    )
    # THEN no window of the other one may decide alone
    assert followed["evidence_window"].value > CONFIG.response.evidence_fail
    assert strange["evidence_window"].value < CONFIG.response.evidence_fail
    assert strange["evidence"].value <= followed["evidence"].value


def test_drives_without_windows_say_nothing_of_gains_and_evidence() -> None:
    # GIVEN a drive, and three that are over before the engine is warm
    model, drive = Model.load(shipped_model()), load(LOG, period_s=0.1)
    n = 100
    short = replace(drive, t_s=drive.t_s[:n], values=drive.values[:n], quality=drive.quality[:n])
    # WHEN the limits are set THEN they are those of the drive alone
    alone = rules.response_limits(model, [drive], LIMITS, CONFIG)
    beside = rules.response_limits(model, [drive, short, short, short], LIMITS, CONFIG)
    for name in ("gain_model", "evidence", "evidence_window"):
        assert beside[name].value == alone[name].value, name
    assert rules._most_evidence(model, [short], LIMITS, CONFIG) == [0.0]


def test_an_earlier_calibration_does_not_change_the_next_one() -> None:
    # GIVEN a card that an earlier calibration gave little weight and long stillness
    model, drive = Model.load(shipped_model()), load(LOG, period_s=0.1)
    earlier = replace(LIMITS, evidence=0.1, still_s=100.0, still_end_s=100.0)
    # WHEN its limits are set anew THEN they are those of a card without any
    found = [rules.response_limits(model, [drive] * 2, own, CONFIG) for own in (earlier, LIMITS)]
    assert found[0] == found[1]
