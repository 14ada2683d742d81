"""Effects between the exhaust valve and the reading."""

import math
from functools import partial
from typing import Final

from training.greybox.effects.effect import Changed, Effect, Parameter, Place, Values
from training.greybox.quantity.value import clip, exp, maximum, where

DEAD_TIME_MAX_S: Final = 3.0
MIXING_MAX_S: Final = 5.0
LEAK_MAX: Final = 0.5  # share of the gas
TAIL_FLOW_KG_H: Final = 20.0  # at which the tail's time is the parameter
TAIL_FACTOR_MIN: Final = 0.2
REFERENCE_KPA: Final = 98.5
DROP_FLOW_KG_H: Final = 200.0  # at which the pressure drop is 100 kPa
SPAN_MIN, SPAN_MAX = 0.1, 5.0


@partial(
    Effect,
    says="dead time follows the exhaust's flow",
    look_at="a sensor that sits nearer to the valves than on the healthy vehicle",
    parameters=(Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0, 8.0), positive=True),),
    needs=("engine_speed_rpm",),
    tag="physics",
)
def delay_flow(at: Place, p: Values) -> Changed:
    """Let the exhaust fill a volume before it reaches the sensor: volume over flow."""
    dead_time_s = at.of("dead_time_s") + at.passage_s(p[0])
    return {"dead_time_s": clip(dead_time_s, 0.0, DEAD_TIME_MAX_S)}


@partial(
    Effect,
    says="mixing follows the exhaust's flow",
    look_at="a sensor that sits where the exhaust mixes less than on the healthy vehicle",
    parameters=(Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0), positive=True),),
    needs=("engine_speed_rpm",),
    tag="physics",
)
def mix_flow(at: Place, p: Values) -> Changed:
    """Let the exhaust mix in a volume, whose time constant is volume over flow."""
    mixing_s = at.of("mixing_s") + at.passage_s(p[0])
    return {"mixing_s": clip(mixing_s, 0.0, MIXING_MAX_S)}


@partial(
    Effect,
    says="a leak draws air into the exhaust at low flow",
    look_at="fuel that enters at low flow: dripping injectors, vapour of the crankcase",
    parameters=(
        Parameter("fraction", "-", -0.3, 0.4, (0.02,), positive=True),
        Parameter("fading", "kg/h", 8.0, 120.0, (20.0, 50.0)),
        Parameter("place", "-", 0.0, 1.0, (0.5,), spread=0.5),
    ),
    needs=("engine_speed_rpm",),
    tag="fault-like",
)
def exhaust_leak(at: Place, p: Values) -> Changed:
    """Draw air in through a leak by pulsation; its share fades with the flow.

    Air that enters near the valves (place 0) travels to the sensor with the exhaust; air that
    enters at the sensor (place 1) is read at once.
    """
    fraction, fading_kg_h, place = p
    drawn = fraction * exp(-at.flow_kg_h() / fading_kg_h)
    kept = 1.0 - clip(drawn, -LEAK_MAX, LEAK_MAX)
    return {
        "factor": at.of("factor") * kept ** (1.0 - place),
        "gas_factor": at.of("gas_factor") * kept**place,
    }


@partial(
    Effect,
    says="the exhaust stays lean after a fuel cut",
    look_at="the ECU's enrichment after a fuel cut, and dripping injectors",
    parameters=(
        Parameter("depth", "-", -0.5, 2.0, (0.05,), positive=True),
        Parameter("time", "s", 0.2, 8.0, (2.0,)),
        Parameter("exponent", "-", 0.0, 1.0, (0.5,), spread=0.5),
    ),
    needs=("engine_speed_rpm",),
    tag="physics",
)
def fuel_cut_tail(at: Place, p: Values) -> Changed:
    """Let the cut fill a store that empties in a time over a power of the exhaust's flow.

    Power 1 is a dead volume that is washed out; power 0 is a constant time, as of dry walls.
    """
    depth, time_s, exponent = p
    runs = at.injecting()
    tail = at.lag(where(runs, 0.0, 1.0), time_s * (TAIL_FLOW_KG_H / at.flow_kg_h()) ** exponent)
    kept = maximum(1.0 - depth * where(runs, tail, 0.0), TAIL_FACTOR_MIN)
    return {"gas_factor": at.of("gas_factor") * kept}


@partial(
    Effect,
    says="the sensor follows one direction slower than the other",
    parameters=(Parameter("logarithm", "-", -2.5, 2.5, (0.3, -0.3)),),
    tag="either",
    like=("slow_rich_to_lean", "slow_lean_to_rich"),
)
def sensor_asymmetry(at: Place, p: Values) -> Changed:
    """Above 0 the sensor follows a rising phi (lean to rich) slower, a falling one faster."""
    return {
        "sensor_rising_s": at.of("sensor_rising_s") * math.exp(p[0]),
        "sensor_falling_s": at.of("sensor_falling_s") * math.exp(-p[0]),
    }


@partial(
    Effect,
    says="exhaust pressure raises the sensor's sensitivity",
    look_at="a pressure correction of the reading that is too strong",
    parameters=(Parameter("sensitivity", "1/bar", -2.0, 6.0, (0.3,), positive=True),),
    needs=("engine_speed_rpm",),
    optional=("ambient_pressure_kpa",),
    tag="physics",
)
def back_pressure(at: Place, p: Values) -> Changed:
    """The pressure at the sensor is ambient plus a drop with the square of the exhaust's flow."""
    relative = at.flow_kg_h() / DROP_FLOW_KG_H
    drop_kpa = 100.0 * (relative * relative)
    above_kpa = drop_kpa + (at.ambient_kpa(without=REFERENCE_KPA) - REFERENCE_KPA)
    factor = clip(1.0 + 0.01 * p[0] * above_kpa, SPAN_MIN, SPAN_MAX)
    return {"span": at.of("span") * factor}
