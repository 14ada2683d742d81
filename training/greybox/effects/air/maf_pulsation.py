"""Air meter pulsation: the air meter reads too much at low speed and high load.

Air that flows back counts as air drawn in, so the error is never negative. Its form is a bump over
engine speed that grows with manifold pressure above 0.6 of ambient. The ECU's charge follows the
error up to a limit.
"""

from typing import Final

from training.greybox.effects.form.air_meter import FOLLOWED, metered_kg_h, taken_over
from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, exp, maximum, tanh

BUMP_RPM: Final = 450.0  # width over engine speed
LOAD_MIN: Final = 0.6  # manifold over ambient pressure


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    magnitude, centre_rpm, limit, followed_s = p
    off = (at.signal("engine_speed_rpm") - centre_rpm) / BUMP_RPM
    bump, metered = exp(-(off * off)), metered_kg_h(at)
    load = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - LOAD_MIN, 0.0)
    error_kg_h = at.lag(magnitude * bump * load * metered, followed_s)
    wrong = taken_over(at, error_kg_h, metered, followed_s)
    return at.air_times(1.0 - limit * tanh(wrong / limit))


EFFECT: Final = Effect(
    name="maf_pulsation",
    says="pulsation makes the air meter read too much",
    look_at="pulsation by which the meter reads too little, and the ECU's correction of it",
    parameters=(
        Parameter("magnitude", "-", -1.0, 4.0, (0.2,), positive=True),
        Parameter("centre", "1/min", 800.0, 2500.0, (1200.0, 1800.0)),
        Parameter("limit", "-", 0.02, 0.5, (0.1,)),
        FOLLOWED,
    ),
    needs=("engine_speed_rpm", "manifold_pressure_kpa", "maf_kg_h"),
    optional=("ambient_pressure_kpa",),
    tag="physics",
    equation=_equation,
)
