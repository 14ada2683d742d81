"""What the naming is asked on vehicles of the second engine: effects, faults and nothing.

All drives are simulated, by other equations than those of the dynamometer and the library.
"""

from collections.abc import Iterator
from typing import NamedTuple

from benchmarks.studies.second.engine import SOUND, Sensor

NULLS = 5
SIZES = {
    "wall_film": 1.5,
    "delay_flow": 5.0,
    "mix_flow": 5.0,
    "sensor_asymmetry": 3.0,
    "injector_offset": 2.0,
    "rail_exponent": 2.0,
    "maf_offset": 1.0,
    "maf_pulsation": 1.5,
    "purge": 12.0,
    "exhaust_leak": 6.0,
    "back_pressure": 4.0,
    "scavenging": 1.5,
    "fuel_cut_tail": 4.0,
    "manifold_filling": 6.0,
    "ethanol": 3.0,
}
REVERSED = {  # in the direction that they cannot have by themselves
    "wall_film": -1.0,
    "delay_flow": -4.0,
    "maf_pulsation": -1.5,
    "purge": -6.0,
    "exhaust_leak": -5.0,
    "back_pressure": -4.0,
    "scavenging": -2.0,
    "fuel_cut_tail": -4.0,
}
FAULTS = {
    "slow by 0.25 s": Sensor(lag_s=0.25),
    "late by 0.2 s": Sensor(dead_time_s=0.2),
    "gain of 0.8": Sensor(gain=0.8),
    "offset of 0.03": Sensor(offset_lambda=0.03),
}
ONSETS = {
    "slow by 0.4 s": Sensor(lag_s=0.4),
    "late by 0.3 s": Sensor(dead_time_s=0.3),
    "gain of 0.7": Sensor(gain=0.7),
    "offset of 0.05": Sensor(offset_lambda=0.05),
}
ONSET_DRIVE = 2  # of the drives in their order


class EngineCase(NamedTuple):
    """What a vehicle has and from when on."""

    kind: str
    what: str
    size: float = 0.0
    sensor: Sensor = SOUND
    from_drive: int = 0


def cases() -> Iterator[EngineCase]:
    """Yield what is tried on each vehicle."""
    for number in range(NULLS):
        yield EngineCase("null", f"drives {number + 1}")
    for effect, size in SIZES.items():
        yield EngineCase("effect", effect, size)
    for what, sensor in FAULTS.items():
        yield EngineCase("fault", what, sensor=sensor)
    for what, sensor in ONSETS.items():
        yield EngineCase("onset", what, sensor=sensor, from_drive=ONSET_DRIVE)
    for effect, size in REVERSED.items():
        yield EngineCase("reversed", effect, size)
