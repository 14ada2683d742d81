"""The rear sensor against a switching front sensor."""

import math

import pytest

from monitor.base import config
from monitor.judge.catalyst.rear_activity import RearActivity
from tests.helpers.drives.switching_drive import switching_drive

SETTINGS = config.shipped().catalyst


def judged(*, burning: bool = True, **drive: float | bool) -> RearActivity:
    activity = RearActivity(config.shipped())
    for t_s, front_v, rear_v in zip(*switching_drive(**drive), strict=True):  # type: ignore[arg-type]
        activity.push(t_s, front_v, rear_v, burning=burning)
    return activity


def test_behind_an_empty_can_the_rear_sensor_repeats_the_front_sensor() -> None:
    activity = judged(stores=False)
    claim = activity.claim()
    assert (claim.outcome, claim.fault) == ("failed", "catalyst_low")
    assert activity.followed > 0.9 * activity.trials > 20


def test_a_catalyst_that_stores_lets_only_long_excursions_pass() -> None:
    activity = judged(stores=True)
    assert activity.claim().outcome == "passed"
    assert activity.followed < 0.3 * activity.trials


@pytest.mark.parametrize("stores", [True, False])
def test_a_slow_logger_or_a_fuel_cut_decides_nothing(stores: bool) -> None:
    slow = judged(stores=stores, period_s=1.0)
    assert (slow.trials, slow.claim().outcome) == (0, "inconclusive")
    assert judged(stores=stores, burning=False).trials == 0


def test_a_sensor_that_is_later_than_transport_and_lag_never_makes_an_empty_can_pass_soon() -> None:
    # a rear sensor that follows after 0.7 s still follows
    assert judged(stores=False, late_s=0.7).claim().outcome == "failed"


def test_a_missing_value_ends_all_trials() -> None:
    activity = RearActivity(config.shipped())
    for t_s, front_v, rear_v in zip(*switching_drive(stores=False), strict=True):
        activity.push(t_s, front_v, math.nan if t_s % 0.6 < 0.1 else rear_v, burning=True)
    assert activity.trials == 0
