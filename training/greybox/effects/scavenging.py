"""Scavenging: air blows through both open valves at high load and low speed.

The sensor reads this air as lean. Its share grows in proportion to manifold pressure above 0.9 of
ambient and fades out towards an engine speed.
"""

from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import air_times, ambient_kpa
from training.greybox.effects.form.value import clip, maximum, minimum

LOAD_MIN: Final = 0.9  # manifold over ambient pressure
FADE_RPM: Final = 600.0
SHARE_MAX: Final = 0.5


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    magnitude, end_rpm = p
    drive = np.maximum(signals["manifold_pressure_kpa"] / ambient_kpa(signals) - LOAD_MIN, 0.0)
    fade = np.clip((end_rpm - signals["engine_speed_rpm"]) / FADE_RPM, 0.0, 1.0)
    return air_times(path, 1.0 + np.minimum(magnitude * drive * fade, SHARE_MAX))


def _nodes(at: Place, p: Values) -> PathNodes:
    magnitude, end_rpm = p
    drive = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - LOAD_MIN, 0.0)
    fade = clip((end_rpm - at.signal("engine_speed_rpm")) / FADE_RPM, 0.0, 1.0)
    return at.air_times(1.0 + minimum(magnitude * drive * fade, SHARE_MAX))


EFFECT: Final = Effect(
    name="scavenging",
    says="air blows through while both valves are open",
    parameters=(
        Parameter("magnitude", "-", -0.5, 5.0, (0.2,), positive=True),
        Parameter("end", "1/min", 1600.0, 4000.0, (2400.0, 3200.0)),
    ),
    needs=("engine_speed_rpm", "manifold_pressure_kpa"),
    optional=("ambient_pressure_kpa",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes),
)
