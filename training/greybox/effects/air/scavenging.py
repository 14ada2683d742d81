"""Scavenging: air blows through both open valves at high load and low speed.

The sensor reads this air as lean. Its share grows in proportion to manifold pressure above 0.9 of
ambient and fades out towards an engine speed.
"""

from typing import Final

from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.quantity.value import Quantity, clip, maximum, minimum

LOAD_MIN: Final = 0.9  # manifold over ambient pressure
FADE_RPM: Final = 600.0
SHARE_MAX: Final = 0.5


def _equation(at: Place, p: Values) -> dict[str, Quantity]:
    magnitude, end_rpm = p
    drive = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - LOAD_MIN, 0.0)
    fade = clip((end_rpm - at.signal("engine_speed_rpm")) / FADE_RPM, 0.0, 1.0)
    return at.air_times(1.0 + minimum(magnitude * drive * fade, SHARE_MAX))


EFFECT: Final = Effect(
    name="scavenging",
    says="air blows through while both valves are open",
    look_at="charge that the ECU's scavenging correction takes away too much",
    parameters=(
        Parameter("magnitude", "-", -0.5, 5.0, (0.2,), positive=True),
        Parameter("end", "1/min", 1600.0, 4000.0, (2400.0, 3200.0)),
    ),
    needs=("engine_speed_rpm", "manifold_pressure_kpa"),
    optional=("ambient_pressure_kpa",),
    tag="physics",
    equation=_equation,
)
