"""A reading that stands still in healthy recordings is given more time before it is stuck."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from monitor.base import config
from monitor.judge.limits import Limits
from monitor.memory.codes import TESTS
from monitor.model.step import Model
from monitor.report.replay import shipped_model
from training.limits.judging import judge
from training.limits.response_limits import response_limits
from training.recordings.recording import Recording, load

LOG = Path("replay_logs/healthy_micro_trips_v102_s102.blf")
SETTINGS = config.load()
MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SETTINGS, "shipped")
FIRST, EVERY, HOLD_S = 1000, 1500, 90.0  # samples at which a hold begins, and how long it lasts


@cache
def healthy() -> Recording:
    return load(LOG, period_s=0.1)


def holding(recording: Recording, hold_s: float, every: int = EVERY) -> Recording:
    """Return the recording of a logger that repeats the reading for a while now and then."""
    values, place = recording.values.copy(), recording.names.index("lambda_measured")
    n = round(hold_s * 10)
    for first in range(FIRST, len(values) - n, every):
        values[first : first + n, place] = values[first, place]
    return replace(recording, values=values)


def stuck(recording: Recording, still_s: float) -> bool:
    judged = judge(recording, MODEL, replace(LIMITS, still_s=still_s), SETTINGS)
    return any(change.dtc.fault in TESTS["activity"] for change in judged.changes)


def test_a_reading_that_moves_keeps_the_usual_time() -> None:
    assert response_limits(MODEL, [healthy()], LIMITS, SETTINGS)["still_s"].value == 0.0


def test_a_logger_that_repeats_readings_has_longer_to_do_so_and_a_dead_sensor_is_still_found() -> (
    None
):
    logged = holding(healthy(), HOLD_S)
    still_s = response_limits(MODEL, [logged], LIMITS, SETTINGS)["still_s"].value
    assert SETTINGS.plausibility.stuck_s < still_s < HOLD_S
    assert stuck(logged, 0.0)
    assert not stuck(logged, still_s)
    assert stuck(holding(logged, 300.0, every=len(logged.values)), still_s)
