"""Injector offset: every injection gives a constant mass more than commanded.

A wrong dead time of the injectors does this; it matters most where injections are short.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import injecting
from training.greybox.effects.form.value import maximum, where


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    return replace(path, fuel_mg=np.maximum(path.fuel_mg + p[0] * injecting(signals), 0.0))


def _nodes(at: Place, p: Values) -> PathNodes:
    fuel = at.of("fuel_mg")
    return at.changed(fuel_mg=maximum(fuel + where(at.injecting(), p[0], 0.0), 0.0))


EFFECT: Final = Effect(
    name="injector_offset",
    says="every injection gives a constant mass more or less",
    parameters=(Parameter("offset", "mg/stroke", -3.0, 3.0, (0.1,)),),
    needs=(),
    tag="either",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes),
)
