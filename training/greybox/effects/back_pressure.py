"""Back pressure: exhaust pressure raises the sensor's sensitivity.

The pressure at the sensor is ambient plus a drop with the square of the exhaust's flow.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import ambient_kpa, flow_kg_h
from training.greybox.effects.form.value import clip

REFERENCE_KPA: Final = 98.5
REFERENCE_FLOW_KG_H: Final = 200.0  # at which the drop is 100 kPa
SPAN_MIN: Final = 0.1
SPAN_MAX: Final = 5.0


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    drop_kpa = 100.0 * (flow_kg_h(path, signals) / REFERENCE_FLOW_KG_H) ** 2
    above_kpa = drop_kpa + ambient_kpa(signals, without=REFERENCE_KPA) - REFERENCE_KPA
    factor = np.clip(1.0 + p[0] * 0.01 * above_kpa, SPAN_MIN, SPAN_MAX)
    return replace(path, span=path.span * factor)


def _nodes(at: Place, p: Values) -> PathNodes:
    relative = at.flow_kg_h() / REFERENCE_FLOW_KG_H
    drop_kpa = 100.0 * (relative * relative)
    above_kpa = drop_kpa + (at.ambient_kpa(without=REFERENCE_KPA) - REFERENCE_KPA)
    return at.changed(span=at.of("span") * clip(1.0 + 0.01 * p[0] * above_kpa, SPAN_MIN, SPAN_MAX))


EFFECT: Final = Effect(
    name="back_pressure",
    says="exhaust pressure raises the sensor's sensitivity",
    parameters=(Parameter("sensitivity", "1/bar", -2.0, 6.0, (0.3,), positive=True),),
    needs=("engine_speed_rpm",),
    optional=("ambient_pressure_kpa",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes),
)
