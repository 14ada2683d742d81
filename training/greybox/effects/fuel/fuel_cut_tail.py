"""Fuel cut tail: after a fuel cut the gas stays lean for a while.

Air leaves a dead volume, and walls are dry. The cut fills a store, which empties afterwards in a
time over a power of the exhaust's flow: power 1 is a volume that is washed out, power 0 a constant
time.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.effects.form.quantities import FLOW_MIN_KG_H
from training.greybox.quantity.value import Quantity, maximum, where

REFERENCE_FLOW_KG_H: Final = 20.0  # at which the tail's time is the parameter
FACTOR_MIN: Final = 0.2


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    depth, time_s, exponent = p
    runs = at.injecting()
    cut = where(runs, 0.0, 1.0)
    tail = at.lag(cut, time_s * (REFERENCE_FLOW_KG_H / at.flow_kg_h()) ** exponent)
    kept = maximum(1.0 - depth * where(runs, tail, 0.0), FACTOR_MIN)
    return {"gas_factor": at.of("gas_factor") * kept}


def _longest_s(p: Values) -> float:
    """Return the time in s in which a tail empties at the least flow."""
    return p[1] * (REFERENCE_FLOW_KG_H / FLOW_MIN_KG_H) ** p[2]


EFFECT: Final = Effect(
    name="fuel_cut_tail",
    says="the exhaust stays lean after a fuel cut",
    look_at="the ECU's enrichment after a fuel cut, and dripping injectors",
    parameters=(
        Parameter("depth", "-", -0.5, 2.0, (0.05,), positive=True),
        Parameter("time", "s", 0.2, 8.0, (2.0,)),
        Parameter("exponent", "-", 0.0, 1.0, (0.5,), spread=0.5),
    ),
    needs=("engine_speed_rpm",),
    tag="physics",
    equation=_equation,
    lag_s=_longest_s,
)
