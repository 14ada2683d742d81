"""Whether the sensor was alive when a recording ended.

A test that passed early says nothing of a sensor that dies later. An electrical fault needs a few
seconds until it sets a code; within this time the recording may end.
"""

from typing import Final

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, Quality
from monitor.judge.causes.observation import Observation
from monitor.judge.electrical.readiness import ENGINE, READY
from monitor.judge.enable import CONDITIONS
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard

DEAD: Final = {  # in words
    "stale": "came no longer",
    "invalid": "had no value",
    "out_of_range": "was out of range",
    "not_ready": "was not ready",
    "frozen": "did not move any more",
    "pegged": "stood at the end of its range",
}
_BY_QUALITY: Final[dict[int, str]] = {
    Quality.STALE: "stale",
    Quality.OFF_BUS: "stale",
    Quality.INVALID: "invalid",
    Quality.GAP: "invalid",  # the log left it out
    Quality.OUT_OF_RANGE: "out_of_range",
    Quality.PINNED: "pegged",
}
_VALID: Final = CONDITIONS.index("measured_valid")
_RECOVERED: Final = CONDITIONS.index("fuel_cut_recovered")


def dead_at_end(
    seen: Observation, card: ModelCard, config: Config, limits: Limits | None
) -> str | None:
    """Return how the sensor was dead when the recording ended, a key of DEAD; None if it was alive.

    limits : with which the recording was judged
    A sensor need not be alive while the engine stands. It was dead if it gave no usable value in
    the last samples, or if its last values are all alike. In a fuel cut a healthy sensor stands
    still at the end of its range, and where it may do so for longer than the last values last, they
    say nothing.
    """
    own, output = config.plausibility, card.output
    silent, still = (round(s / seen.period_s) for s in (own.end_s, own.stuck_s))
    at, burning = seen.names.index(output.name), seen.end_conditions[:, _RECOVERED]
    measured, quality = seen.end_values[:, at], seen.end_quality[:, at]
    running = _running(seen, own.engine_running_rpm)
    gone = quality != Quality.GOOD  # in a fuel cut a pinned reading is the right one
    gone &= (quality != Quality.PINNED) | burning
    if READY in seen.names:
        gone |= seen.end_values[:, seen.names.index(READY)] <= 0.0
    if _all(gone & running, max(silent, 1)):
        return _BY_QUALITY.get(int(quality[-1]), "not_ready")
    n = max(still, 2)
    valid = seen.end_conditions[:, _VALID] & running
    if not _all(valid, n) or np.ptp(measured[-n:]) > own.stuck_range:
        return None
    is_within = measured[-1] < output.maximum
    if limits is not None and (limits.still_s if is_within else limits.still_end_s):
        return None
    if is_within:
        return "frozen"
    return "pegged" if np.count_nonzero(burning[-n:]) >= max(silent, 2) else None


def _all(true: BoolArray, n: int) -> bool:
    """Return whether the last n samples are there and true."""
    return len(true) >= n and bool(true[-n:].all())


def _running(seen: Observation, running_rpm: float) -> BoolArray:
    """Return whether the engine ran in the last samples; without its speed it did.

    A speed that is no longer known holds on. A speed that is not known for longer than the kept
    samples belongs to an ECU that sleeps; awake, its silence would have set a code.
    """
    if ENGINE not in seen.names or not len(seen.end_values):
        return np.ones(len(seen.end_values), dtype=np.bool_)
    speed_rpm = seen.end_values[:, seen.names.index(ENGINE)]
    known = np.maximum.accumulate(np.where(np.isnan(speed_rpm), 0, np.arange(len(speed_rpm))))
    return np.asarray(speed_rpm[known] >= running_rpm)
