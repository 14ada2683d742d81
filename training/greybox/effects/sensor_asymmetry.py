"""Sensor asymmetry: a healthy sensor follows one direction slower than the other.

For a logarithm above 0 the sensor follows a rising phi (lean to rich) slower and a falling phi
faster, by the same factor.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    return replace(
        path,
        sensor_rising_s=path.sensor_rising_s * np.exp(p[0]),
        sensor_falling_s=path.sensor_falling_s * np.exp(-p[0]),
    )


def _nodes(at: Place, p: Values) -> PathNodes:
    return at.changed(
        sensor_rising_s=at.of("sensor_rising_s") * math.exp(p[0]),
        sensor_falling_s=at.of("sensor_falling_s") * math.exp(-p[0]),
    )


def _slower(p: Values) -> float:
    return math.exp(abs(p[0])) - 1.0


EFFECT: Final = Effect(
    name="sensor_asymmetry",
    says="the sensor follows one direction slower than the other",
    parameters=(Parameter("logarithm", "-", -2.5, 2.5, (0.3, -0.3)),),
    needs=(),
    tag="either",
    like=("slow_rich_to_lean", "slow_lean_to_rich"),
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, slower=_slower),
)
