"""Air meter offset: the air meter reads a constant flow too much, and the ECU's charge follows.

The constant is the part that the charge takes over: a charge that follows the meter in part shows
that part alone.
"""

from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.air_meter import FOLLOWED, metered_nodes, taken_over
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import air_times


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    offset_kg_h, followed_s = p
    error_kg_h = np.full(len(path), offset_kg_h)
    return air_times(path, 1.0 - taken_over(error_kg_h, followed_s, signals, period_s))


def _nodes(at: Place, p: Values) -> PathNodes:
    offset_kg_h, followed_s = p
    wrong = offset_kg_h / at.lag(metered_nodes(at), followed_s)
    return at.air_times(1.0 - at.lag(wrong, followed_s))


EFFECT: Final = Effect(
    name="maf_offset",
    says="the air meter reads a constant flow too much",
    parameters=(Parameter("offset", "kg/h", -8.0, 8.0, (0.2,)), FOLLOWED),
    needs=("maf_kg_h",),
    tag="fault-like",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, n_states=3),
)
