"""Ethanol: fuel with a fraction of ethanol needs less air.

The stoichiometric ratio falls from 14.7 to 9.0 by mass in proportion to the fraction, which is a
constant factor on the mixture: humidity and slope errors of air meter or injectors look the same.
"""

from typing import Final

from training.greybox.chain import STOICHIOMETRIC
from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity

ETHANOL_AIR_FUEL: Final = 9.0  # stoichiometric, by mass
GAIN_OF_ETHANOL: Final = 1.0 - ETHANOL_AIR_FUEL / STOICHIOMETRIC  # of the mixture, per fraction


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    return {"factor": at.of("factor") * (1.0 - p[0] * GAIN_OF_ETHANOL)}


EFFECT: Final = Effect(
    name="ethanol",
    says="the fuel's stoichiometric ratio differs",
    parameters=(Parameter("fraction", "-", -0.3, 1.0, (0.05,)),),
    needs=(),
    tag="either",
    like=("biased", "humidity", "slope error of the air meter", "slope error of the injectors"),
    gain_class=True,
    equation=_equation,
)
