"""Effects on the air that the cylinder gets, and how the ECU's charge follows its air meter.

A charge that comes from the air meter follows it at once. A charge that comes from a table and is
corrected by the meter follows over seconds. Healthy drives tell the two apart, see ``following``.
"""

from dataclasses import replace
from functools import partial
from typing import Final

from scipy.constants import zero_Celsius

from training.greybox.chain import AIR_LEAST_MG
from training.greybox.effects.effect import Changed, Effect, Parameter, Place, Values
from training.greybox.quantity.dynamics import proportional_lag
from training.greybox.quantity.value import Quantity, clip, exp, maximum, minimum, tanh

FOLLOWED: Final = Parameter("followed", "s", 0.02, 8.0, (0.05, 2.0))
AT_ONCE: Final = replace(FOLLOWED, high=1.0, start=(0.05,))
SLOWLY: Final = replace(FOLLOWED, low=0.5, start=(2.0,))
AT_ONCE_S: Final = 1.0
METER_MIN_KG_H: Final = 4.0
BUMP_RPM: Final = 450.0  # width of the pulsation over engine speed
PULSATION_LOAD_MIN: Final = 0.6  # manifold over ambient pressure
SCAVENGING_LOAD_MIN: Final = 0.9
FADE_RPM: Final = 600.0  # over which scavenging fades out
SHARE_MAX: Final = 0.5  # of scavenged air
HALF_FLOW_KG_H: Final = 30.0  # at which the charge warms half as much as without flow
CHARGE_MIN_K: Final = 100.0
REFERENCE_RPM: Final = 1500.0  # at which the time constant of the filling is the parameter
FILLING_MIN_RPM: Final = 500.0


def following(effect: Effect, meter_s: float | None) -> Effect:
    """Return the effect for an ECU whose charge follows its air meter over ``meter_s``.

    meter_s : time in s in which the meter corrects the charge; None if unknown
    """
    if meter_s is None or FOLLOWED not in effect.parameters:
        return effect
    followed = AT_ONCE if meter_s <= AT_ONCE_S else SLOWLY
    parameters = tuple(followed if p == FOLLOWED else p for p in effect.parameters)
    return replace(effect, parameters=parameters)


def _metered_kg_h(at: Place) -> Quantity:
    return maximum(at.signal("maf_kg_h"), METER_MIN_KG_H)


def _taken_over(at: Place, error: Quantity, metered: Quantity, followed_s: float) -> Quantity:
    """Return the relative error of the ECU's charge for the filtered error of its air meter.

    The ECU compares filtered flows and learns their difference with the same time constant.
    """
    return at.lag(error / at.lag(metered, followed_s), followed_s)


@partial(
    Effect,
    says="the air meter reads a constant flow too much",
    parameters=(Parameter("offset", "kg/h", -8.0, 8.0, (0.2,)), FOLLOWED),
    needs=("maf_kg_h",),
    tag="fault-like",
)
def maf_offset(at: Place, p: Values) -> Changed:
    """Change the air by the part of the offset that the charge takes over."""
    offset_kg_h, followed_s = p
    return at.air_times(1.0 - _taken_over(at, offset_kg_h, _metered_kg_h(at), followed_s))


@partial(
    Effect,
    says="pulsation makes the air meter read too much",
    look_at="pulsation by which the meter reads too little, and the ECU's correction of it",
    parameters=(
        Parameter("magnitude", "-", -1.0, 4.0, (0.2,), positive=True),
        Parameter("centre", "1/min", 800.0, 2500.0, (1200.0, 1800.0)),
        Parameter("limit", "-", 0.02, 0.5, (0.1,)),
        FOLLOWED,
    ),
    needs=("engine_speed_rpm", "manifold_pressure_kpa", "maf_kg_h"),
    optional=("ambient_pressure_kpa",),
    tag="physics",
)
def maf_pulsation(at: Place, p: Values) -> Changed:
    """Count air that flows back as air drawn in.

    The error is a bump over engine speed that grows with manifold pressure above 0.6 of ambient.
    The ECU's charge follows it up to a limit.
    """
    magnitude, centre_rpm, limit, followed_s = p
    off = (at.signal("engine_speed_rpm") - centre_rpm) / BUMP_RPM
    bump, metered = exp(-(off * off)), _metered_kg_h(at)
    load = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - PULSATION_LOAD_MIN, 0.0)
    error_kg_h = at.lag(magnitude * bump * load * metered, followed_s)
    wrong = _taken_over(at, error_kg_h, metered, followed_s)
    return at.air_times(1.0 - limit * tanh(wrong / limit))


@partial(
    Effect,
    says="air blows through while both valves are open",
    look_at="charge that the ECU's scavenging correction takes away too much",
    parameters=(
        Parameter("magnitude", "-", -0.5, 5.0, (0.2,), positive=True),
        Parameter("end", "1/min", 1600.0, 4000.0, (2400.0, 3200.0)),
    ),
    needs=("engine_speed_rpm", "manifold_pressure_kpa"),
    optional=("ambient_pressure_kpa",),
    tag="physics",
)
def scavenging(at: Place, p: Values) -> Changed:
    """Add air in proportion to manifold pressure above 0.9 of ambient, up to an engine speed."""
    magnitude, end_rpm = p
    pressure = at.signal("manifold_pressure_kpa") / at.ambient_kpa()
    drive = maximum(pressure - SCAVENGING_LOAD_MIN, 0.0)
    fade = clip((end_rpm - at.signal("engine_speed_rpm")) / FADE_RPM, 0.0, 1.0)
    return at.air_times(1.0 + minimum(magnitude * drive * fade, SHARE_MAX))


@partial(
    Effect,
    says="walls warm the charge behind the temperature sensor",
    parameters=(
        Parameter("share", "-", -0.6, 0.8, (0.05,)),
        Parameter("learned", "-", 0.0, 0.9, (0.5,), spread=0.5),
        SLOWLY,
    ),
    needs=("coolant_temperature_degc", "manifold_temperature_degc", "maf_kg_h"),
    tag="physics",
)
def charge_temperature(at: Place, p: Values) -> Changed:
    """Warm the charge by a share of the coolant's excess, less at high flow.

    An ECU that corrects its charge by an air meter learns a share of the loss over seconds.
    """
    share, learned, followed_s = p
    manifold = at.signal("manifold_temperature_degc")
    excess = at.signal("coolant_temperature_degc") - manifold
    warmed = share * excess / (1.0 + maximum(at.signal("maf_kg_h"), 0.0) / HALF_FLOW_KG_H)
    kelvin = manifold + zero_Celsius
    left = kelvin / maximum(kelvin + warmed, CHARGE_MIN_K)
    return at.air_times(left / (1.0 - learned * at.lag(1.0 - left, followed_s)))


@partial(
    Effect,
    says="the charge is later or earlier than broadcast while load moves",
    parameters=(Parameter("time", "s", -0.4, 0.4, (0.02, -0.02)),),
    needs=("engine_speed_rpm",),
    tag="physics",
)
def manifold_filling(at: Place, p: Values) -> Changed:
    """Let the logarithm of the charge follow with a time in inverse proportion to engine speed.

    It is slower up and faster down than the mass. A time below 0 is an ECU whose estimate of the
    filling is late, so that the charge is ahead of it.
    """
    time_s = abs(p[0]) * REFERENCE_RPM / maximum(at.signal("engine_speed_rpm"), FILLING_MIN_RPM)
    charge = maximum(at.of("air_mg"), AIR_LEAST_MG)
    late = proportional_lag(charge, time_s, at.period_s)
    return {"air_mg": late if p[0] >= 0.0 else charge * charge / late}
