"""Air meter offset: the air meter reads a constant flow too much, and the ECU's charge follows.

The constant is the part that the charge takes over: a charge that follows the meter in part shows
that part alone.
"""

from typing import Final

from training.greybox.effects.form.air_meter import FOLLOWED, metered_kg_h, taken_over
from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    offset_kg_h, followed_s = p
    return at.air_times(1.0 - taken_over(at, offset_kg_h, metered_kg_h(at), followed_s))


EFFECT: Final = Effect(
    name="maf_offset",
    says="the air meter reads a constant flow too much",
    parameters=(Parameter("offset", "kg/h", -8.0, 8.0, (0.2,)), FOLLOWED),
    needs=("maf_kg_h",),
    tag="fault-like",
    equation=_equation,
)
