"""Delay by flow: the exhaust must fill a volume before it reaches the sensor.

The dead time grows by volume over flow.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import longest_passage_s, passage_s
from training.greybox.effects.form.value import clip

DEAD_TIME_MAX_S: Final = 3.0


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    dead_time_s = path.dead_time_s + passage_s(path, p[0], signals)
    return replace(path, dead_time_s=np.clip(dead_time_s, 0.0, DEAD_TIME_MAX_S))


def _nodes(at: Place, p: Values) -> PathNodes:
    dead_time_s = at.of("dead_time_s") + at.passage_s(p[0])
    return at.changed(dead_time_s=clip(dead_time_s, 0.0, DEAD_TIME_MAX_S))


def _longest_s(p: Values) -> float:
    return min(longest_passage_s(p[0]), DEAD_TIME_MAX_S)


EFFECT: Final = Effect(
    name="delay_flow",
    says="dead time follows the exhaust's flow",
    parameters=(Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0, 8.0), positive=True),),
    needs=("engine_speed_rpm",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, dead_time_s=_longest_s),
)
