"""The naming on an engine that neither the dynamometer's equations nor the library's made."""

from functools import cache, partial

from benchmarks.studies.second.engine import SOUND, Sensor, drive
from training.gap.name.naming import name
from training.greybox.chain import Constants
from training.healthy import yardstick
from training.healthy.behaviour import Healthy

driven = partial(drive, 2, length_s=400.0)  # of vehicle 2


@cache
def known() -> Healthy:
    return yardstick.learn([driven(2000 + i) for i in range(3)], Constants())


def test_the_healthy_vehicle_has_volumes_of_its_own() -> None:
    volumes = {each.name: each.values[0] for each in known().own}
    assert set(volumes) == {"delay_flow", "mix_flow"}
    assert min(volumes.values()) > 0.1  # litres


def test_an_effect_and_a_slow_sensor_of_a_second_engine_are_told() -> None:
    for hidden, sensor, said in (
        ({}, SOUND, ("no_gap", [])),
        ({"wall_film": 1.5}, SOUND, ("named", ["wall_film"])),
        ({}, Sensor(lag_s=0.25), ("sensor_fault_suspected", [])),
    ):
        found = name([driven(2100 + i, hidden, sensor) for i in range(2)], known())
        assert (found.verdict, [each.name for each in found.answer.effects]) == said
