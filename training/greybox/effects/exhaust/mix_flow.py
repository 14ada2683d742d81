"""Mixing by flow: the exhaust mixes in a volume.

The time constant of mixing grows by volume over flow.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.effects.form.quantities import longest_passage_s
from training.greybox.quantity.value import Quantity, clip

MIXING_MAX_S: Final = 5.0


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    mixing_s = at.of("mixing_s") + at.passage_s(p[0])
    return {"mixing_s": clip(mixing_s, 0.0, MIXING_MAX_S)}


def _longest_s(p: Values) -> float:
    return min(longest_passage_s(p[0]), MIXING_MAX_S)


EFFECT: Final = Effect(
    name="mix_flow",
    says="mixing follows the exhaust's flow",
    look_at="a sensor that sits where the exhaust mixes less than on the healthy vehicle",
    parameters=(Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0), positive=True),),
    needs=("engine_speed_rpm",),
    tag="physics",
    equation=_equation,
    lag_s=_longest_s,
)
