"""Purge: fuel vapour of the canister comes with the purge air.

The vapour flow is its concentration times the valve's duty times the pressure drop to the
manifold, behind the lag of line and intake. Without a duty signal the valve is taken to be half
open while the engine is warm and driving.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, maximum, where

VAPOUR_LAG_S: Final = 1.0  # canister line and intake
WARM_DEGC: Final = 60.0
DRIVING_RPM: Final = 1000.0
DUTY_PERCENT: Final = 50.0  # while the valve is taken to be open


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    fuel = at.of("fuel_mg")
    drop_kpa = maximum(at.ambient_kpa() - at.signal("manifold_pressure_kpa"), 0.0)
    if "purge_duty_percent" in at.signals:
        duty = at.signal("purge_duty_percent")
    else:
        duty = where(_is_allowed(at), DUTY_PERCENT, 0.0)
    vapour_mg_s = at.lag(p[0] * 0.01 * duty * drop_kpa, VAPOUR_LAG_S)
    return {"fuel_mg": fuel + where(at.injecting(), vapour_mg_s / at.strokes_per_s(), 0.0)}


def _is_allowed(at: Place) -> Quantity:
    allowed = (at.signal("engine_speed_rpm") > DRIVING_RPM) & at.injecting()
    if "coolant_temperature_degc" in at.signals:
        allowed = allowed & (at.signal("coolant_temperature_degc") > WARM_DEGC)
    return allowed


EFFECT: Final = Effect(
    name="purge",
    says="canister purge brings fuel vapour",
    look_at="air through the purge valve: an empty canister whose vapour the ECU takes for granted",
    parameters=(Parameter("concentration", "mg/s/kPa", -2.0, 8.0, (0.3,), positive=True),),
    needs=("manifold_pressure_kpa", "engine_speed_rpm"),
    optional=("ambient_pressure_kpa", "purge_duty_percent", "coolant_temperature_degc"),
    superseded=(("coolant_temperature_degc", "purge_duty_percent"),),
    tag="physics",
    varies=True,
    equation=_equation,
)
