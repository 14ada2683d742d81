"""Effects on the exhaust's way from the valves to the sensor."""

from dataclasses import replace

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.dynamics import lag
from training.greybox.effects.effect import (
    GAS_KG_PER_M3,
    Effect,
    Parameter,
    Signals,
    flow_kg_h,
    injecting,
)

DEAD_TIME_MAX_S, MIXING_MAX_S = 3.0, 5.0
TAIL_FLOW_KG_H = 20.0  # at which a tail has its time
TAIL_FACTOR_MIN = 0.2


def _passage_s(path: Path, litres: float, signals: Signals) -> FloatArray:
    """Return how long the exhaust takes through a volume, (n,) in s."""
    litres_per_s = flow_kg_h(path, signals) / 3600.0 / GAS_KG_PER_M3 * 1e3
    return np.asarray(litres / litres_per_s)


def _delay_flow(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """The exhaust must fill a volume before it reaches the sensor: dead time is volume by flow."""
    dead_time_s = path.dead_time_s + _passage_s(path, p[0], signals)
    return replace(path, dead_time_s=np.clip(dead_time_s, 0.0, DEAD_TIME_MAX_S))


def _mix_flow(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """The exhaust mixes in a volume: a time constant of volume by flow."""
    mixing_s = path.mixing_s + _passage_s(path, p[0], signals)
    return replace(path, mixing_s=np.clip(mixing_s, 0.0, MIXING_MAX_S))


def _exhaust_leak(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Pulsation draws air in through a leak; the share fades with the exhaust's flow.

    Near the valves (place 0) what it dilutes then travels to the sensor, where it is at once with
    place 1.
    """
    fraction, fading_kg_h, place = p
    drawn = fraction * np.exp(-flow_kg_h(path, signals) / fading_kg_h)
    kept = 1.0 - np.clip(drawn, -0.5, 0.5)
    return replace(
        path,
        factor=path.factor * kept ** (1.0 - place),
        gas_factor=path.gas_factor * kept**place,
    )


def _fuel_cut_tail(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """After a fuel cut the gas stays lean for a while: air leaves a dead volume, walls are dry.

    The cut fills a store and it empties afterwards, in a time over a power of the exhaust's flow:
    1 is a volume that is washed out, 0 a time of its own.
    """
    depth, time_s, exponent = p
    cut = ~injecting(signals)
    emptied_s = time_s * (TAIL_FLOW_KG_H / flow_kg_h(path, signals)) ** exponent
    tail = lag(cut.astype(np.float64), emptied_s, period_s)
    kept = np.maximum(1.0 - depth * tail * ~cut, TAIL_FACTOR_MIN)
    return replace(path, gas_factor=path.gas_factor * kept)


EFFECTS = (
    Effect(
        "delay_flow",
        "dead time follows the exhaust's flow",
        (Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0, 8.0), positive=True),),
        _delay_flow,
        ("engine_speed_rpm",),
        "physics",
    ),
    Effect(
        "mix_flow",
        "mixing follows the exhaust's flow",
        (Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0), positive=True),),
        _mix_flow,
        ("engine_speed_rpm",),
        "physics",
    ),
    Effect(
        "exhaust_leak",
        "a leak draws air into the exhaust at low flow",
        (
            Parameter("fraction", "-", -0.3, 0.4, (0.02,), positive=True),
            Parameter("fading", "kg/h", 8.0, 120.0, (20.0, 50.0)),
            Parameter("place", "-", 0.0, 1.0, (0.5,), spread=0.5),
        ),
        _exhaust_leak,
        ("engine_speed_rpm",),
        "fault-like",
    ),
    Effect(
        "fuel_cut_tail",
        "the exhaust stays lean after a fuel cut",
        (
            Parameter("depth", "-", -0.5, 2.0, (0.05,), positive=True),
            Parameter("time", "s", 0.2, 8.0, (2.0,)),
            Parameter("exponent", "-", 0.0, 1.0, (0.5,), spread=0.5),
        ),
        _fuel_cut_tail,
        ("engine_speed_rpm",),
        "physics",
    ),
)
