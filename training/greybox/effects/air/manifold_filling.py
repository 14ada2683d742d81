"""Manifold filling: the runner fills later than the manifold's sensor says.

The charge follows with a time constant in inverse proportion to engine speed. It follows in its
logarithm: slower up and faster down than in mass. A time below 0 is an ECU whose estimate of the
filling is late, so that the charge is ahead of it.
"""

from typing import Final

from training.greybox.chain import AIR_LEAST_MG
from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, maximum

REFERENCE_RPM: Final = 1500.0  # at which the time constant is the parameter
FILLING_MIN_RPM: Final = 500.0


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    time_s = abs(p[0]) * REFERENCE_RPM / maximum(at.signal("engine_speed_rpm"), FILLING_MIN_RPM)
    charge = maximum(at.of("air_mg"), AIR_LEAST_MG)
    late = at.proportional_lag(charge, time_s)
    return {"air_mg": late if p[0] >= 0.0 else charge * charge / late}


EFFECT: Final = Effect(
    name="manifold_filling",
    says="the charge is later or earlier than broadcast while load moves",
    parameters=(Parameter("time", "s", -0.4, 0.4, (0.02, -0.02)),),
    needs=("engine_speed_rpm",),
    tag="physics",
    equation=_equation,
)
