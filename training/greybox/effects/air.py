"""Effects on the air that reaches the cylinder, against what the ECU takes it for."""

from dataclasses import replace

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import AIR_LEAST_MG, Path
from training.greybox.effects.dynamics import lag, ramp_lag
from training.greybox.effects.effect import KELVIN, Effect, Parameter, Signals, ambient_kpa

# The time in which the ECU's charge follows its air meter: at once, or over seconds where a table
# gives the charge and the meter corrects it. Healthy drives tell which, see ``following``.
FOLLOWED = Parameter("followed", "s", 0.02, 8.0, (0.05, 2.0))
AT_ONCE = replace(FOLLOWED, high=1.0, start=(0.05,))
SLOWLY = replace(FOLLOWED, low=0.5, start=(2.0,))
AT_ONCE_S = 1.0
METER_MIN_KG_H = 4.0
AIR_FACTOR_MIN, AIR_FACTOR_MAX = 0.5, 2.0


def _scaled(path: Path, factor: FloatArray) -> Path:
    """Return the path with the cylinder's air times a bounded factor."""
    return replace(path, air_mg=path.air_mg * np.clip(factor, AIR_FACTOR_MIN, AIR_FACTOR_MAX))


def _taken_over(
    error_kg_h: FloatArray, followed_s: float, signals: Signals, period_s: float
) -> FloatArray:
    """Return the relative error of the ECU's charge (n,) for an error of its air meter.

    Filtered flows are compared, and what differs is learned with the same time constant.
    """
    maf = np.maximum(signals["maf_kg_h"], METER_MIN_KG_H)
    wrong = lag(error_kg_h, followed_s, period_s) / lag(maf, followed_s, period_s)
    return lag(wrong, followed_s, period_s)


def following(effect: Effect, meter_s: float | None) -> Effect:
    """Return the effect for an ECU whose charge follows its air meter over ``meter_s``.

    meter_s : time over which the error of its charge is corrected; None if not known
    """
    if meter_s is None or FOLLOWED not in effect.parameters:
        return effect
    known = AT_ONCE if meter_s <= AT_ONCE_S else SLOWLY
    own = tuple(known if p == FOLLOWED else p for p in effect.parameters)
    return replace(effect, parameters=own)


def _maf_offset(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """The air meter reads a constant flow too much, and the ECU's charge follows it.

    The constant is what the charge takes over; a charge that follows the meter in part only shows
    that part.
    """
    offset = np.full(len(path), p[0])
    return _scaled(path, 1.0 - _taken_over(offset, p[1], signals, period_s))


def _maf_pulsation(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Pulsation makes the air meter read too much at low speed and high load.

    What flows back counts as air drawn in, so it is never too little. A bump over engine speed,
    growing with manifold pressure above 0.6 of ambient; the ECU's charge follows up to a limit.
    """
    magnitude, centre_rpm, limit, followed_s = p
    bump = np.exp(-(((signals["engine_speed_rpm"] - centre_rpm) / 450.0) ** 2))
    load = np.maximum(signals["manifold_pressure_kpa"] / ambient_kpa(signals) - 0.6, 0.0)
    error_kg_h = magnitude * bump * load * np.maximum(signals["maf_kg_h"], METER_MIN_KG_H)
    taken_over = _taken_over(error_kg_h, followed_s, signals, period_s)
    return _scaled(path, 1.0 - limit * np.tanh(taken_over / limit))


def _scavenging(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Air blows through both open valves at high load and low speed; the sensor sees it as lean.

    In proportion to manifold pressure above 0.9 of ambient, fading out towards an engine speed.
    """
    magnitude, end_rpm = p
    drive = np.maximum(signals["manifold_pressure_kpa"] / ambient_kpa(signals) - 0.9, 0.0)
    fade = np.clip((end_rpm - signals["engine_speed_rpm"]) / 600.0, 0.0, 1.0)
    return _scaled(path, 1.0 + np.minimum(magnitude * drive * fade, 0.5))


def _charge_temperature(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Hot walls warm the charge behind the manifold's sensor, less at high flow.

    An ECU that corrects its charge by an air meter learns a share of what is lost, over seconds.
    """
    share, learned, followed_s = p
    manifold = signals["manifold_temperature_degc"]
    excess = signals["coolant_temperature_degc"] - manifold
    warmed = share * excess / (1.0 + np.maximum(signals["maf_kg_h"], 0.0) / 30.0)
    lost = 1.0 - (manifold + KELVIN) / np.maximum(manifold + KELVIN + warmed, 100.0)
    return _scaled(path, (1.0 - lost) / (1.0 - learned * lag(lost, followed_s, period_s)))


def _manifold_filling(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """The runner fills later than the manifold's sensor says, by a time over engine speed.

    The charge follows in proportion, in its logarithm: slower up and faster down than in mass. With
    a time below 0 the ECU's estimate of the filling is late, and the charge ahead of it.
    """
    time_s = abs(p[0]) * 1500.0 / np.maximum(signals["engine_speed_rpm"], 500.0)
    charge = np.log(np.maximum(path.air_mg, AIR_LEAST_MG))
    late = ramp_lag(charge, time_s, period_s)
    return replace(path, air_mg=np.exp(late if p[0] >= 0.0 else 2.0 * charge - late))


EFFECTS = (
    Effect(
        "maf_offset",
        "the air meter reads a constant flow too much",
        (Parameter("offset", "kg/h", -8.0, 8.0, (0.2,)), FOLLOWED),
        _maf_offset,
        ("maf_kg_h",),
        "fault-like",
    ),
    Effect(
        "maf_pulsation",
        "pulsation makes the air meter read too much",
        (
            Parameter("magnitude", "-", -1.0, 4.0, (0.2,), positive=True),
            Parameter("centre", "1/min", 800.0, 2500.0, (1200.0, 1800.0)),
            Parameter("limit", "-", 0.02, 0.5, (0.1,)),
            FOLLOWED,
        ),
        _maf_pulsation,
        ("engine_speed_rpm", "manifold_pressure_kpa", "maf_kg_h"),
        "physics",
    ),
    Effect(
        "scavenging",
        "air blows through while both valves are open",
        (
            Parameter("magnitude", "-", -0.5, 5.0, (0.2,), positive=True),
            Parameter("end", "1/min", 1600.0, 4000.0, (2400.0, 3200.0)),
        ),
        _scavenging,
        ("engine_speed_rpm", "manifold_pressure_kpa"),
        "physics",
    ),
    Effect(
        "charge_temperature",
        "walls warm the charge behind the temperature sensor",
        (
            Parameter("share", "-", -0.6, 0.8, (0.05,)),
            Parameter("learned", "-", 0.0, 0.9, (0.5,), spread=0.5),
            SLOWLY,
        ),
        _charge_temperature,
        ("coolant_temperature_degc", "manifold_temperature_degc", "maf_kg_h"),
        "physics",
    ),
    Effect(
        "manifold_filling",
        "the charge is later or earlier than broadcast while load moves",
        (Parameter("time", "s", -0.4, 0.4, (0.02, -0.02), least=0.005),),
        _manifold_filling,
        ("engine_speed_rpm",),
        "physics",
    ),
)
