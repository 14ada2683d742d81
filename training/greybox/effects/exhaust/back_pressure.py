"""Back pressure: exhaust pressure raises the sensor's sensitivity.

The pressure at the sensor is ambient plus a drop with the square of the exhaust's flow.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, clip

REFERENCE_KPA: Final = 98.5
REFERENCE_FLOW_KG_H: Final = 200.0  # at which the drop is 100 kPa
SPAN_MIN: Final = 0.1
SPAN_MAX: Final = 5.0


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    relative = at.flow_kg_h() / REFERENCE_FLOW_KG_H
    drop_kpa = 100.0 * (relative * relative)
    above_kpa = drop_kpa + (at.ambient_kpa(without=REFERENCE_KPA) - REFERENCE_KPA)
    factor = clip(1.0 + 0.01 * p[0] * above_kpa, SPAN_MIN, SPAN_MAX)
    return {"span": at.of("span") * factor}


EFFECT: Final = Effect(
    name="back_pressure",
    says="exhaust pressure raises the sensor's sensitivity",
    look_at="a pressure correction of the reading that is too strong",
    parameters=(Parameter("sensitivity", "1/bar", -2.0, 6.0, (0.3,), positive=True),),
    needs=("engine_speed_rpm",),
    optional=("ambient_pressure_kpa",),
    tag="physics",
    equation=_equation,
)
