"""Exhaust leak: pulsation draws air in through a leak, and its share fades with the flow.

Air that enters near the valves (place 0) travels to the sensor with the exhaust; air that enters
at the sensor (place 1) is read at once.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, clip, exp

SHARE_MAX: Final = 0.5


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    fraction, fading_kg_h, place = p
    drawn = fraction * exp(-at.flow_kg_h() / fading_kg_h)
    kept = 1.0 - clip(drawn, -SHARE_MAX, SHARE_MAX)
    return {
        "factor": at.of("factor") * kept ** (1.0 - place),
        "gas_factor": at.of("gas_factor") * kept**place,
    }


EFFECT: Final = Effect(
    name="exhaust_leak",
    says="a leak draws air into the exhaust at low flow",
    look_at="fuel that enters at low flow: dripping injectors, vapour of the crankcase",
    parameters=(
        Parameter("fraction", "-", -0.3, 0.4, (0.02,), positive=True),
        Parameter("fading", "kg/h", 8.0, 120.0, (20.0, 50.0)),
        Parameter("place", "-", 0.0, 1.0, (0.5,), spread=0.5),
    ),
    needs=("engine_speed_rpm",),
    tag="fault-like",
    equation=_equation,
)
