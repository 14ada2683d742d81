"""How the ECU's charge follows its air meter.

A charge that comes from the air meter follows it at once. A charge that comes from a table and is
corrected by the meter follows over seconds. Healthy drives tell the two apart, see ``following``.
"""

from dataclasses import replace
from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, maximum

FOLLOWED: Final = Parameter("followed", "s", 0.02, 8.0, (0.05, 2.0))
AT_ONCE: Final = replace(FOLLOWED, high=1.0, start=(0.05,))
SLOWLY: Final = replace(FOLLOWED, low=0.5, start=(2.0,))
AT_ONCE_S: Final = 1.0
METER_MIN_KG_H: Final = 4.0


def following(effect: Effect, meter_s: float | None) -> Effect:
    """Return the effect for an ECU whose charge follows its air meter over ``meter_s``.

    meter_s : time in s in which the meter corrects the charge; None if unknown
    """
    if meter_s is None or FOLLOWED not in effect.parameters:
        return effect
    followed = AT_ONCE if meter_s <= AT_ONCE_S else SLOWLY
    parameters = tuple(followed if p == FOLLOWED else p for p in effect.parameters)
    return replace(effect, parameters=parameters)


def metered_kg_h(at: Place) -> Quantity:
    """Return the air meter's flow, at least 4 kg/h."""
    return maximum(at.signal("maf_kg_h"), METER_MIN_KG_H)


def taken_over(at: Place, error: Quantity, metered: Quantity, followed_s: float) -> Quantity:
    """Return the relative error of the ECU's charge for the filtered error of its air meter.

    The ECU compares filtered flows and learns their difference with the same time constant.
    """
    return at.lag(error / at.lag(metered, followed_s), followed_s)
