"""How long the reading of healthy recordings stands still bounds the tests of a still reading."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from monitor.base import config
from monitor.judge.limits import Limits
from monitor.memory.codes import TESTS
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from training.limits.judging import judge_recordings
from training.limits.response.stillness import DAY_S, next_longest, still_limits
from training.recordings.recording import Recording, load

LOG = Path("replay_logs/healthy_micro_trips_v102_s102.blf")
SETTINGS = config.load()
MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SETTINGS, "shipped")
FIRST, EVERY, HOLD_S = 1000, 1500, 90.0  # samples at which a hold begins, and how long it lasts


@cache
def healthy() -> Recording:
    return load(LOG, period_s=0.1)


def with_readings(values: np.ndarray, *, tells_cut: bool = True) -> Recording:
    recording = healthy()
    names = list(recording.names)
    table = recording.values.copy()
    table[:, names.index("lambda_measured")] = values
    if not tells_cut:
        names[names.index("fuel_cut")] = "fuel_cut_of_nobody"
    return replace(recording, values=table, names=tuple(names))


def readings() -> np.ndarray:
    return healthy().column("lambda_measured")


def holding(hold_s: float, every: int = EVERY) -> Recording:
    """Return the recording of a logger that repeats the reading for a while now and then."""
    values, n = readings().copy(), round(hold_s * 10)
    for first in range(FIRST, len(values) - n, every):
        values[first : first + n] = values[first]
    return with_readings(values)


def stuck(recording: Recording, still_s: float) -> bool:
    judged = judge_recordings([recording], MODEL, replace(LIMITS, still_s=still_s), SETTINGS)[0]
    return any(change.dtc.fault in TESTS["activity"] for change in judged.changes)


def still(name: str, *recordings: Recording) -> float | None:
    """Return a limit, None if the usual time suffices."""
    found = still_limits(recordings, MODEL.card, SETTINGS)
    return found[name].value if name in found else None


def test_a_reading_that_moves_keeps_the_usual_time_even_with_one_recording() -> None:
    assert still("still_s", healthy()) is None


def test_a_reading_in_whole_hundredths_keeps_the_usual_time() -> None:
    noisy = readings() + 0.01 * np.random.default_rng(3).standard_normal(len(readings()))
    assert still("still_s", with_readings(np.round(noisy, 2))) is None


def test_a_reading_that_once_stood_still_for_minutes_is_no_longer_called_stuck() -> None:
    logged = holding(HOLD_S)
    assert stuck(logged, 0.0)
    learned = still("still_s", logged) or 0.0
    assert learned > 10 * HOLD_S
    assert not stuck(logged, learned)


def test_the_bound_holds_for_a_drive_after_a_single_one_and_tightens_with_more() -> None:
    # GIVEN drives whose stretches follow the law that the bound supposes, with a common exponent
    rng = np.random.default_rng(5)
    drives = np.expm1(rng.exponential(0.25, size=(4000, 300)))
    # WHEN the longest stretch of each is compared with the bound of the one before, and of eight
    single = [next_longest([drive.tolist()]) for drive in drives[:-1]]
    several = [next_longest(drives[k : k + 8].tolist()) for k in range(0, 3992, 40)]
    beyond = np.count_nonzero(drives[1:].max(axis=1) > single)
    # THEN about one of a thousand exceeds it
    assert 0 < beyond <= 12
    assert np.median(several) < np.median(single)


def test_one_long_stretch_of_a_single_drive_supports_no_bound() -> None:
    assert next_longest([[40.0]]) == DAY_S


def test_a_drive_without_a_stretch_leaves_the_usual_time() -> None:
    assert next_longest([[]]) == 0.0


def test_the_end_of_the_range_has_a_time_of_its_own_where_no_signal_tells_the_fuel_cut() -> None:
    # GIVEN a reading that stands at its end for longer now and then, as that of a lean engine
    values, end = readings().copy(), MODEL.card.output.maximum
    for k, n in enumerate((50, 200, 350, 500, 600)):
        values[500 + 800 * k :][:n] = end
    # WHEN the fuel cut is told or not
    silent = with_readings(values, tells_cut=False)
    # THEN only the second has time at the end, and the usual time elsewhere
    assert still("still_end_s", with_readings(values)) is None
    assert (still("still_end_s", silent) or 0.0) > SETTINGS.plausibility.fuel_cut_most_s
    assert still("still_s", silent) is None
