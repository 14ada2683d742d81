"""Sensor asymmetry: a healthy sensor follows one direction slower than the other.

For a logarithm above 0 the sensor follows a rising phi (lean to rich) slower and a falling phi
faster, by the same factor.
"""

import math
from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    return {
        "sensor_rising_s": at.of("sensor_rising_s") * math.exp(p[0]),
        "sensor_falling_s": at.of("sensor_falling_s") * math.exp(-p[0]),
    }


def _slower(p: Values) -> float:
    return math.exp(abs(p[0])) - 1.0


EFFECT: Final = Effect(
    name="sensor_asymmetry",
    says="the sensor follows one direction slower than the other",
    parameters=(Parameter("logarithm", "-", -2.5, 2.5, (0.3, -0.3)),),
    needs=(),
    tag="either",
    like=("slow_rich_to_lean", "slow_lean_to_rich"),
    equation=_equation,
    slower=_slower,
)
