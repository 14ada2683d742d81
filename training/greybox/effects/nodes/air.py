"""Effects on the air that reaches the cylinder, as ``effects.air`` has them."""

from training.greybox.chain import AIR_LEAST_MG
from training.greybox.effects.air import AIR_FACTOR_MAX, AIR_FACTOR_MIN, METER_MIN_KG_H
from training.greybox.effects.effect import KELVIN
from training.greybox.effects.nodes.form import Form, Parameters
from training.greybox.effects.nodes.place import Place
from training.greybox.effects.nodes.value import Value, clip, exp, maximum, minimum, tanh
from training.greybox.graph.nodes import Nodes

AMBIENT = ("ambient_pressure_kpa",)


def _scaled(at: Place, factor: Value) -> Nodes:
    return at.changed(air_mg=at.of("air_mg") * clip(factor, AIR_FACTOR_MIN, AIR_FACTOR_MAX))


def _meter_kg_h(at: Place) -> Value:
    return maximum(at.signal("maf_kg_h"), METER_MIN_KG_H)


def _maf_offset(at: Place, p: Parameters) -> Nodes:
    offset_kg_h, followed_s = p
    wrong = offset_kg_h / at.lag(_meter_kg_h(at), followed_s)
    return _scaled(at, 1.0 - at.lag(wrong, followed_s))


def _maf_pulsation(at: Place, p: Parameters) -> Nodes:
    magnitude, centre_rpm, limit, followed_s = p
    off = (at.signal("engine_speed_rpm") - centre_rpm) / 450.0
    bump, meter = exp(-(off * off)), _meter_kg_h(at)
    load = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - 0.6, 0.0)
    error_kg_h = at.lag(magnitude * bump * load * meter, followed_s)
    wrong = error_kg_h / at.lag(meter, followed_s)
    taken_over = at.lag(wrong, followed_s)
    return _scaled(at, 1.0 - limit * tanh(taken_over / limit))


def _scavenging(at: Place, p: Parameters) -> Nodes:
    magnitude, end_rpm = p
    drive = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - 0.9, 0.0)
    fade = clip((end_rpm - at.signal("engine_speed_rpm")) / 600.0, 0.0, 1.0)
    return _scaled(at, 1.0 + minimum(magnitude * drive * fade, 0.5))


def _charge_temperature(at: Place, p: Parameters) -> Nodes:
    share, learned, followed_s = p
    manifold = at.signal("manifold_temperature_degc")
    excess = at.signal("coolant_temperature_degc") - manifold
    warmed = share * excess / (1.0 + maximum(at.signal("maf_kg_h"), 0.0) / 30.0)
    kelvin = manifold + KELVIN
    left = kelvin / maximum(kelvin + warmed, 100.0)
    return _scaled(at, left / (1.0 - learned * at.lag(1.0 - left, followed_s)))


def _manifold_filling(at: Place, p: Parameters) -> Nodes:
    time_s = abs(p[0]) * 1500.0 / maximum(at.signal("engine_speed_rpm"), 500.0)
    charge = maximum(at.of("air_mg"), AIR_LEAST_MG)
    late = at.ramp_lag_in_proportion(charge, time_s)
    return at.changed(air_mg=late if p[0] >= 0.0 else charge * charge / late)


FORMS = {
    "maf_offset": Form(_maf_offset, 3),
    "maf_pulsation": Form(_maf_pulsation, 4, AMBIENT),
    "scavenging": Form(_scavenging, 0, AMBIENT),
    "charge_temperature": Form(_charge_temperature, 2),
    "manifold_filling": Form(_manifold_filling, 3),
}
