"""Effects on the fuel that reaches the cylinder, as ``effects.fuel`` has them."""

from training.greybox.effects.fuel import (
    GAIN_OF_ETHANOL,
    REFERENCE_RAIL_MPA,
    VAPOUR_LAG_S,
    WARM_DEGC,
)
from training.greybox.effects.nodes.form import Form, Parameters
from training.greybox.effects.nodes.place import Place
from training.greybox.effects.nodes.value import Value, maximum, minimum, where
from training.greybox.graph.nodes import Nodes


def _strokes_per_s(at: Place) -> Value:
    return maximum(at.signal("engine_speed_rpm"), 400.0) / 30.0


def _wall_film(at: Place, p: Parameters) -> Nodes:
    share, time_s, cold_growth = p
    fuel, grown = at.of("fuel_mg"), None
    if "coolant_temperature_degc" in at.signals:
        cold = maximum(WARM_DEGC - at.signal("coolant_temperature_degc"), 0.0) / 60.0
        grown = 1.0 + cold_growth * cold
    strokes_per_s = _strokes_per_s(at)
    landed = fuel * (min(share, 0.8) if grown is None else minimum(share * grown, 0.8))
    lag_s = time_s if grown is None else time_s * grown
    evaporated = at.lag(landed * strokes_per_s, lag_s) / strokes_per_s
    return at.changed(fuel_mg=fuel - landed + evaporated)


def _injector_offset(at: Place, p: Parameters) -> Nodes:
    fuel = at.of("fuel_mg")
    return at.changed(fuel_mg=maximum(fuel + where(at.injecting(), p[0], 0.0), 0.0))


def _rail_exponent(at: Place, p: Parameters) -> Nodes:
    ratio = maximum(at.signal("rail_pressure_mpa"), 0.5) / REFERENCE_RAIL_MPA
    return at.changed(fuel_mg=at.of("fuel_mg") * ratio ** p[0])


def _purge(at: Place, p: Parameters) -> Nodes:
    fuel = at.of("fuel_mg")
    drop_kpa = maximum(at.ambient_kpa() - at.signal("manifold_pressure_kpa"), 0.0)
    if "purge_duty_percent" in at.signals:
        duty = at.signal("purge_duty_percent")
    else:
        duty = where(_purge_allowed(at), 50.0, 0.0)
    vapour_mg_s = at.lag(p[0] * 0.01 * duty * drop_kpa, VAPOUR_LAG_S)
    more = where(at.injecting(), vapour_mg_s / _strokes_per_s(at), 0.0)
    return at.changed(fuel_mg=fuel + more)


def _purge_allowed(at: Place) -> Value:
    allowed = (at.signal("engine_speed_rpm") > 1000.0) & at.injecting()
    if "coolant_temperature_degc" in at.signals:
        allowed = allowed & (at.signal("coolant_temperature_degc") > 60.0)
    return allowed


def _ethanol(at: Place, p: Parameters) -> Nodes:
    return at.changed(factor=at.of("factor") * (1.0 - p[0] * GAIN_OF_ETHANOL))


FORMS = {
    "wall_film": Form(_wall_film, 2, ("coolant_temperature_degc",)),
    "injector_offset": Form(_injector_offset),
    "rail_exponent": Form(_rail_exponent),
    "purge": Form(
        _purge,
        2,
        ("ambient_pressure_kpa", "purge_duty_percent", "coolant_temperature_degc"),
        {"coolant_temperature_degc": "purge_duty_percent"},
    ),
    "ethanol": Form(_ethanol),
}
