"""Injector offset: every injection gives a constant mass more than commanded.

A wrong dead time of the injectors does this; it matters most where injections are short.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, maximum, where


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    fuel = at.of("fuel_mg")
    return {"fuel_mg": maximum(fuel + where(at.injecting(), p[0], 0.0), 0.0)}


EFFECT: Final = Effect(
    name="injector_offset",
    says="every injection gives a constant mass more or less",
    parameters=(Parameter("offset", "mg/stroke", -3.0, 3.0, (0.1,)),),
    needs=(),
    tag="either",
    equation=_equation,
)
