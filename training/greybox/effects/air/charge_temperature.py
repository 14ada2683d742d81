"""Charge temperature: hot walls warm the charge behind the manifold's sensor.

The charge warms by a share of the coolant's excess, less at high flow, and loses mass. An ECU that
corrects its charge by an air meter learns a share of the loss over seconds.
"""

from typing import Final

from training.greybox.effects.form.air_meter import SLOWLY
from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.effects.form.quantities import KELVIN
from training.greybox.quantity.value import Quantity, maximum

HALF_FLOW_KG_H: Final = 30.0  # at which the charge warms half as much as without flow
CHARGE_MIN_K: Final = 100.0


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    share, learned, followed_s = p
    manifold = at.signal("manifold_temperature_degc")
    excess = at.signal("coolant_temperature_degc") - manifold
    warmed = share * excess / (1.0 + maximum(at.signal("maf_kg_h"), 0.0) / HALF_FLOW_KG_H)
    kelvin = manifold + KELVIN
    left = kelvin / maximum(kelvin + warmed, CHARGE_MIN_K)
    return at.air_times(left / (1.0 - learned * at.lag(1.0 - left, followed_s)))


EFFECT: Final = Effect(
    name="charge_temperature",
    says="walls warm the charge behind the temperature sensor",
    parameters=(
        Parameter("share", "-", -0.6, 0.8, (0.05,)),
        Parameter("learned", "-", 0.0, 0.9, (0.5,), spread=0.5),
        SLOWLY,
    ),
    needs=("coolant_temperature_degc", "manifold_temperature_degc", "maf_kg_h"),
    tag="physics",
    equation=_equation,
)
