"""Delay by flow: the exhaust must fill a volume before it reaches the sensor.

The dead time grows by volume over flow.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.effects.form.quantities import longest_passage_s
from training.greybox.quantity.value import Quantity, clip

DEAD_TIME_MAX_S: Final = 3.0


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    dead_time_s = at.of("dead_time_s") + at.passage_s(p[0])
    return {"dead_time_s": clip(dead_time_s, 0.0, DEAD_TIME_MAX_S)}


def _longest_s(p: Values) -> float:
    return min(longest_passage_s(p[0]), DEAD_TIME_MAX_S)


EFFECT: Final = Effect(
    name="delay_flow",
    says="dead time follows the exhaust's flow",
    look_at="a sensor that sits nearer to the valves than on the healthy vehicle",
    parameters=(Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0, 8.0), positive=True),),
    needs=("engine_speed_rpm",),
    tag="physics",
    equation=_equation,
    dead_time_s=_longest_s,
)
