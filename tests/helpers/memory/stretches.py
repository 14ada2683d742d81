"""Drives of a few stretches, as samples."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.base import config
from monitor.base.types import Quality, Sample, SampleBlock
from monitor.memory.cycles import SIGNALS

CONFIG = config.load()
NAMES = ("lambda_measured", *SIGNALS)
MINUTE, HOUR = 60.0, 3600.0


@dataclass(frozen=True)
class Stretch:
    """So many seconds in which nothing changes."""

    seconds: float
    speed_rpm: float = 1500.0
    speed_km_h: float = 0.0
    coolant_degc: float = 90.0
    ambient_degc: float = 20.0
    pressure_kpa: float = 100.0
    quality: Quality = Quality.GOOD


DRIVE = Stretch(5 * MINUTE, speed_km_h=50.0)
STAND = Stretch(1.0, speed_rpm=0.0)
SILENCE = Stretch(1.0, quality=Quality.STALE)
START = Stretch(5.0)


def lasting(stretch: Stretch, seconds: float) -> Stretch:
    return replace(stretch, seconds=seconds)


def samples(
    stretches: list[Stretch], period_s: float = 1.0, names: tuple[str, ...] = NAMES
) -> Iterator[Sample]:
    k = 0
    for each in stretches:
        read = {
            "lambda_measured": 1.0,
            "engine_speed_rpm": each.speed_rpm,
            "vehicle_speed_km_h": each.speed_km_h,
            "coolant_temperature_degc": each.coolant_degc,
            "ambient_temperature_degc": each.ambient_degc,
            "ambient_pressure_kpa": each.pressure_kpa,
        }
        is_good = each.quality == Quality.GOOD
        values = np.array([read[name] if is_good else math.nan for name in names])
        quality = np.full(len(names), each.quality, dtype=np.uint8)
        for _ in range(round(each.seconds / period_s)):
            k += 1
            yield Sample(k, round(k * period_s * 1e9), values, quality)


OFF_BUS = Stretch(5.0, quality=Quality.OFF_BUS)


def block_of(drive: Sequence[Sample]) -> SampleBlock:
    """Return samples side by side."""
    index, t_ns, values, quality = (np.array(column) for column in zip(*drive, strict=True))
    return SampleBlock(index, t_ns, values, quality.astype(np.uint8))
