"""Whether the sensor was alive when a recording ended.

A test that passed early says nothing of a sensor that dies later. An electrical fault needs a few
seconds until it sets a code; within this time the recording may end.
"""

from typing import Final, Literal

import numpy as np

from monitor.base.config import Config, PlausibilityConfig
from monitor.base.types import BoolArray, Quality
from monitor.judge.causes.observation import Observation
from monitor.judge.electrical.readiness import ENGINE, READY
from monitor.judge.enable import CONDITIONS
from monitor.judge.limits import Limits
from monitor.model.card import Channel, ModelCard

Dead = Literal["stale", "invalid", "out_of_range", "not_ready", "frozen", "pegged"]
_BY_QUALITY: Final[dict[int, Dead]] = {
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
) -> Dead | None:
    """Return how the sensor was dead when the recording ended, None if it was alive.

    limits : with which the recording was judged
    A sensor need not be alive while the engine stands.
    """
    if not len(seen.end_values):
        return None
    own = config.plausibility
    return _silent(seen, card.output, own) or _still(seen, card.output, own, limits)


def _silent(seen: Observation, output: Channel, config: PlausibilityConfig) -> Dead | None:
    """Return the state of the sensor if it gave no usable value in the last samples."""
    n = max(round(config.end_s / seen.period_s), 1)
    quality = seen.end_quality[-n:, seen.names.index(output.name)]
    dead = quality != Quality.GOOD  # in a fuel cut a pinned reading is the right one
    dead &= (quality != Quality.PINNED) | seen.end_conditions[-n:, _RECOVERED]
    if READY in seen.names:
        dead |= seen.end_values[-n:, seen.names.index(READY)] <= 0.0
    if len(quality) < n or not (dead & _running(seen, config, n)).all():
        return None
    return _BY_QUALITY.get(int(quality[-1]), "not_ready")


def _still(
    seen: Observation, output: Channel, config: PlausibilityConfig, limits: Limits | None
) -> Dead | None:
    """Return the state of the sensor if its last values are all alike though the engine runs.

    In a fuel cut a healthy sensor stands still at the end of its range. Where it may stand still
    for longer than the last values last, they say nothing.
    """
    n, least = (max(round(s / seen.period_s), 2) for s in (config.stuck_s, config.end_s))
    measured = seen.end_values[-n:, seen.names.index(output.name)]
    running = _running(seen, config, n)
    valid = seen.end_conditions[-n:, _VALID] & running
    if len(measured) < n or not valid.all() or np.ptp(measured) > config.stuck_range:
        return None
    is_within = measured[-1] < output.maximum
    if limits is not None and (limits.still_s if is_within else limits.still_end_s):
        return None
    if is_within:
        return "frozen"
    burning = np.count_nonzero(seen.end_conditions[-n:, _RECOVERED])
    return "pegged" if burning >= least else None


def _running(seen: Observation, config: PlausibilityConfig, n: int) -> BoolArray:
    """Return whether the engine ran in the last n samples; without its speed it did.

    A speed that is no longer known holds on. A speed that is not known for longer than the kept
    samples belongs to an ECU that sleeps; awake, its silence would have set a code.
    """
    if ENGINE not in seen.names:
        return np.ones(len(seen.end_values[-n:]), dtype=np.bool_)
    speed_rpm = seen.end_values[:, seen.names.index(ENGINE)]
    known = np.maximum.accumulate(np.where(np.isnan(speed_rpm), 0, np.arange(len(speed_rpm))))
    return np.asarray(speed_rpm[known][-n:] >= config.engine_running_rpm)
