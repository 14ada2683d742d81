"""Drives of a few stretches, as samples."""

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor.base import config
from monitor.base.types import Quality, SampleBlock
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


OFF_BUS = Stretch(5.0, quality=Quality.OFF_BUS)


def samples(
    *stretches: Stretch, period_s: float = 1.0, names: tuple[str, ...] = NAMES
) -> SampleBlock:
    """Return the samples of some stretches, one after another."""
    values, quality = [np.empty((0, len(names)))], [np.empty((0, len(names)), dtype=np.uint8)]
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
        n = round(each.seconds / period_s)
        values.append(np.tile([read[name] if is_good else math.nan for name in names], (n, 1)))
        quality.append(np.full((n, len(names)), each.quality, dtype=np.uint8))
    rows = np.concatenate(values)
    index = np.arange(1, len(rows) + 1)
    t_ns = np.round(index * period_s * 1e9).astype(np.int64)
    return SampleBlock(index, t_ns, rows, np.concatenate(quality))
