"""Rail exponent: injected mass follows rail pressure by another power than a square root.

The ECU takes the square root of Bernoulli's law; cavitation changes the power. The deviation x
makes a factor (p / 10 MPa)**x on the fuel.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, maximum

REFERENCE_RAIL_MPA: Final = 10.0
RAIL_MIN_MPA: Final = 0.5


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    ratio = maximum(at.signal("rail_pressure_mpa"), RAIL_MIN_MPA) / REFERENCE_RAIL_MPA
    return {"fuel_mg": at.of("fuel_mg") * ratio ** p[0]}


EFFECT: Final = Effect(
    name="rail_exponent",
    says="injected mass follows rail pressure by another power",
    parameters=(Parameter("exponent", "-", -0.5, 0.5, (0.05,)),),
    needs=("rail_pressure_mpa",),
    tag="physics",
    equation=_equation,
)
