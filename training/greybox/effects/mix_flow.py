"""Mixing by flow: the exhaust mixes in a volume.

The time constant of mixing grows by volume over flow.
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

MIXING_MAX_S: Final = 5.0


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    mixing_s = path.mixing_s + passage_s(path, p[0], signals)
    return replace(path, mixing_s=np.clip(mixing_s, 0.0, MIXING_MAX_S))


def _nodes(at: Place, p: Values) -> PathNodes:
    mixing_s = at.of("mixing_s") + at.passage_s(p[0])
    return at.changed(mixing_s=clip(mixing_s, 0.0, MIXING_MAX_S))


def _longest_s(p: Values) -> float:
    return min(longest_passage_s(p[0]), MIXING_MAX_S)


EFFECT: Final = Effect(
    name="mix_flow",
    says="mixing follows the exhaust's flow",
    parameters=(Parameter("volume", "l", -1.0, 20.0, (0.5, 2.0), positive=True),),
    needs=("engine_speed_rpm",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, lag_s=_longest_s),
)
