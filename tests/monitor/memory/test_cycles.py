"""The moments that count: driving cycles, engine starts, warm-ups, the general denominator."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import Quality
from monitor.memory.cycles import Cycles
from tests.helpers.memory.stretches import (
    CONFIG,
    DRIVE,
    HOUR,
    MINUTE,
    NAMES,
    OFF_BUS,
    SILENCE,
    STAND,
    START,
    Stretch,
    lasting,
    samples,
)


def cycles_of(
    names: tuple[str, ...] = NAMES, profile: config.ProfileConfig = CONFIG.carb
) -> Cycles:
    return Cycles(CONFIG.cycles, profile, names, "lambda_measured", 500.0)


def moments(
    *stretches: Stretch,
    period_s: float = 1.0,
    names: tuple[str, ...] = NAMES,
    profile: config.ProfileConfig = CONFIG.carb,
) -> list[tuple[str, float]]:
    drive, cycles = samples(*stretches, period_s=period_s, names=names), cycles_of(names, profile)
    found = []
    for begin in range(0, len(drive.t_ns), 50):  # whatever goes on does so over blocks
        part = cycles.push(drive.part(begin, begin + 50)).moments
        found += [(moment, drive.t_ns[begin + k] / 1e9) for k, moment in part]
    return found


def count(what: str, *stretches: Stretch, names: tuple[str, ...] = NAMES) -> int:
    return [moment for moment, _ in moments(*stretches, names=names)].count(what)


@pytest.mark.parametrize(
    ("between", "expected"),
    [
        # start-stop: the ECU is awake
        ([lasting(STAND, 30)], 0),
        ([lasting(STAND, 299)], 0),
        ([lasting(STAND, 300)], 1),
        # ignition off: the ECU falls silent, wakes up and starts the engine
        ([lasting(STAND, 3), lasting(SILENCE, 60), lasting(STAND, 2)], 1),
        ([lasting(SILENCE, 60), lasting(STAND, 2)], 1),
        ([lasting(STAND, 3), lasting(SILENCE, 10), lasting(STAND, 1)], 1),
        ([lasting(STAND, 3), lasting(SILENCE, 9), lasting(STAND, 1)], 0),
        # a loss of the bus: the engine is seen running right after it
        ([lasting(SILENCE, 60)], 0),
        ([lasting(SILENCE, 8), lasting(STAND, 2)], 0),
        ([lasting(SILENCE, 9), lasting(STAND, 1)], 0),
        ([lasting(SILENCE, 10), lasting(STAND, 1)], 1),
        ([lasting(STAND, 3), lasting(SILENCE, 60)], 0),
        ([lasting(SILENCE, 310)], 1),
        # two short silences are no long one
        ([lasting(SILENCE, 8), lasting(STAND, 1), lasting(SILENCE, 8), lasting(STAND, 1)], 0),
        # the monitor itself was off the bus: nothing is known of the engine
        ([Stretch(2 * HOUR, quality=Quality.OFF_BUS)], 0),
        # the ECU is there but does not know its engine speed
        ([Stretch(60, quality=Quality.INVALID), lasting(STAND, 2)], 0),
    ],
)
def test_the_next_driving_cycle_begins_with_an_engine_start_after_ignition_off(
    between: list[Stretch], expected: int
) -> None:
    assert count("driving_cycle", DRIVE, *between, START) == expected


def test_one_drive_stays_one_driving_cycle_however_it_begins() -> None:
    for first in ([], [lasting(STAND, 600)], [lasting(SILENCE, 600)], [SILENCE, STAND]):
        assert count("driving_cycle", *first, DRIVE, lasting(STAND, 600)) == 0


def test_the_new_driving_cycle_begins_with_the_first_sample_of_the_running_engine() -> None:
    found = moments(lasting(DRIVE, 10), lasting(SILENCE, 20), lasting(STAND, 5), START)
    assert [t_s for moment, t_s in found if moment == "driving_cycle"] == [36.0]


def test_without_engine_speed_only_a_long_silence_ends_a_driving_cycle() -> None:
    names = ("lambda_measured", "vehicle_speed_km_h")
    for silence_s, expected in ((60, 0), (310, 1)):
        stretches = (DRIVE, lasting(SILENCE, silence_s), START)
        assert count("driving_cycle", *stretches, names=names) == expected


def test_a_clock_that_steps_back_begins_nothing() -> None:
    cycles, drive = cycles_of(), samples(DRIVE)
    back = drive._replace(t_ns=drive.t_ns - 200_000_000_000)
    found = [moment for part in (drive, back, drive) for _, moment in cycles.push(part).moments]
    assert "driving_cycle" not in found


def test_an_engine_start_counts_after_two_seconds_and_once_in_a_driving_cycle() -> None:
    assert count("ignition_cycle", STAND, lasting(START, 2)) == 0
    assert count("ignition_cycle", *[lasting(START, 2), STAND] * 5) == 0  # it stalls
    found = moments(STAND, lasting(START, 10), lasting(STAND, 30), lasting(START, 10))
    assert [t_s for moment, t_s in found if moment == "ignition_cycle"] == [4.0]


@pytest.mark.parametrize(
    ("profile", "start_degc", "reached_degc", "expected"),
    [
        ("carb", 20.0, 71.2, 1),
        ("carb", 20.0, 71.0, 0),  # not hot enough
        ("carb", 60.0, 82.3, 1),
        ("carb", 60.0, 82.1, 0),  # a rise of less than 40 degF
        ("eobd", 20.0, 70.1, 1),
        ("eobd", 20.0, 69.9, 0),
        ("eobd", 60.0, 82.1, 1),
        ("eobd", 60.0, 81.9, 0),
        ("eobd", 48.0, 70.0, 1),  # both limits themselves
    ],
)
def test_a_warm_up_cycle_needs_a_rise_and_an_end_temperature(
    profile: str, start_degc: float, reached_degc: float, expected: int
) -> None:
    found = moments(
        replace(START, coolant_degc=start_degc),
        replace(DRIVE, coolant_degc=reached_degc),
        replace(DRIVE, coolant_degc=reached_degc - 5.0),
        replace(DRIVE, coolant_degc=reached_degc),
        profile=getattr(CONFIG, profile),
    )
    assert [moment for moment, _ in found].count("warm_up") == expected


def test_the_rise_counts_within_one_driving_cycle() -> None:
    cold, hot = replace(DRIVE, coolant_degc=55.0), replace(DRIVE, coolant_degc=85.0)
    off = [lasting(SILENCE, 60), STAND]
    assert count("warm_up", cold, hot) == 1
    assert count("warm_up", cold, *off, replace(hot, coolant_degc=76.0)) == 0
    # and what an engine at rest does to its coolant is no warming up
    assert count("warm_up", replace(STAND, coolant_degc=20.0), hot) == 0


IDLE = Stretch(30.0 + 1.0)
CITY = Stretch(5 * MINUTE, speed_km_h=30.0)
COLD = replace(IDLE, ambient_degc=-8.0)


def to_the_second(drive_s: float, city_s: float, idle_s: float) -> list[Stretch]:
    parts = ((START, 1.0), (DRIVE, drive_s), (CITY, city_s), (IDLE, idle_s))
    return [lasting(*part) for part in parts]


@pytest.mark.parametrize(
    ("stretches", "expected"),
    [
        ([START, DRIVE, CITY, IDLE], 1),
        (to_the_second(300, 270, 30), 1),
        ([START, replace(DRIVE, speed_km_h=40.0), CITY, replace(IDLE, speed_km_h=1.6)], 1),
        (to_the_second(299, 271, 30), 0),
        (to_the_second(300, 269, 30), 0),
        (to_the_second(300, 271, 29), 0),
        ([START, lasting(DRIVE, 290), CITY, lasting(CITY, 60), IDLE], 0),  # too little fast driving
        ([START, DRIVE, lasting(CITY, 200), IDLE], 0),  # less than 600 s
        ([START, DRIVE, CITY, lasting(IDLE, 20), CITY, lasting(IDLE, 20)], 0),  # not in a row
        ([START, DRIVE, CITY, *[lasting(IDLE, 20), lasting(STAND, 5)] * 3], 0),
        ([START, DRIVE, CITY, *[lasting(IDLE, 20), OFF_BUS] * 3], 0),
        ([START, DRIVE, CITY, CITY, OFF_BUS, lasting(IDLE, 29)], 0),
        ([START, DRIVE, CITY, CITY, OFF_BUS, lasting(IDLE, 30)], 1),
        ([START, DRIVE, CITY, CITY, COLD, lasting(IDLE, 29)], 0),
        ([START, DRIVE, CITY, CITY, COLD, lasting(IDLE, 30)], 1),
        ([START, DRIVE, CITY, lasting(IDLE, 20), replace(COLD, seconds=20), lasting(IDLE, 20)], 0),
        ([START, lasting(DRIVE, 150), IDLE, lasting(DRIVE, 150), CITY], 1),  # in any order
        ([START, DRIVE, lasting(STAND, 60), CITY, IDLE], 1),  # over a stop of the engine
        ([START, DRIVE, lasting(SILENCE, 60), STAND, CITY, IDLE], 0),  # not over ignition off
        ([START, DRIVE, CITY, replace(IDLE, speed_km_h=2.0)], 0),  # rolling is no idle
        ([START, DRIVE, CITY, COLD], 0),
        ([START, replace(DRIVE, ambient_degc=-8.0), CITY, CITY, IDLE], 0),
        ([START, replace(DRIVE, pressure_kpa=75.0), CITY, CITY, IDLE], 0),  # high up
        ([START, DRIVE, CITY, replace(IDLE, pressure_kpa=75.3, ambient_degc=-7.0)], 1),
        ([START, replace(DRIVE, pressure_kpa=math.nan), CITY, CITY, IDLE], 0),  # not known
    ],
)
def test_the_general_denominator_asks_for_time_speed_and_idle(
    stretches: list[Stretch], expected: int
) -> None:
    assert count("general_denominator", *stretches) == expected


def test_a_sensor_that_is_missing_is_no_silence_of_the_ecu() -> None:
    drive = samples(DRIVE, lasting(STAND, 60), START)
    drive.quality[:, NAMES.index("lambda_measured")] = Quality.STALE
    assert "driving_cycle" not in [moment for _, moment in cycles_of().push(drive).moments]


def test_a_signal_that_is_not_provided_asks_for_nothing() -> None:
    names = ("lambda_measured", "engine_speed_rpm", "vehicle_speed_km_h")
    assert count("general_denominator", START, DRIVE, CITY, IDLE, names=names) == 1
    # but what is driven and warmed up cannot be known without its own signal
    cold, names = replace(START, coolant_degc=20.0), ("lambda_measured", "engine_speed_rpm")
    assert count("general_denominator", START, DRIVE, CITY, IDLE, names=names) == 0
    assert count("warm_up", cold, DRIVE, names=names) == 0


def test_running_time_and_distance_are_those_of_the_running_engine() -> None:
    rolling = replace(STAND, speed_km_h=50.0)  # the engine is off, the car rolls
    drive = samples(lasting(DRIVE, 361), lasting(rolling, 100), lasting(DRIVE, 361))
    driven = [each for _, each in cycles_of().push(drive).driven]
    assert sum(each.engine_run_s for each in driven) == pytest.approx(720.0)
    assert sum(each.distance_km for each in driven) == pytest.approx(10.0)
    # and creeping counts as distance
    creeping = samples(START, replace(DRIVE, seconds=3600.0, speed_km_h=0.5))
    driven = [each for _, each in cycles_of().push(creeping).driven]
    assert sum(each.distance_km for each in driven) == pytest.approx(0.5)


KINDS = st.sampled_from([DRIVE, STAND, SILENCE, CITY, IDLE, replace(START, coolant_degc=20.0)])
drives = st.lists(
    st.builds(lambda kind, n: lasting(kind, 5.0 * n), KINDS, st.integers(1, 80)), max_size=12
)


@given(drives)
def test_the_moments_do_not_depend_on_the_sample_period(stretches: list[Stretch]) -> None:
    slow, fast = moments(*stretches), moments(*stretches, period_s=0.25)
    assert [moment for moment, _ in slow] == [moment for moment, _ in fast]
    for (_, a_s), (_, b_s) in zip(slow, fast, strict=True):
        assert abs(a_s - b_s) <= 4.0  # each sample of a start counts no time


@given(drives)
def test_nothing_counts_twice_in_one_driving_cycle(stretches: list[Stretch]) -> None:
    seen: set[str] = set()
    for moment, _ in moments(*stretches):
        if moment == "driving_cycle":
            seen.clear()
        assert moment not in seen
        seen.add(moment)
