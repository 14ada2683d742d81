"""Rail exponent: injected mass follows rail pressure by another power than a square root.

The ECU takes the square root of Bernoulli's law; cavitation changes the power. The deviation x
makes a factor (p / 10 MPa)**x on the fuel.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.value import maximum

REFERENCE_RAIL_MPA: Final = 10.0
RAIL_MIN_MPA: Final = 0.5


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    ratio = np.maximum(signals["rail_pressure_mpa"], RAIL_MIN_MPA) / REFERENCE_RAIL_MPA
    return replace(path, fuel_mg=path.fuel_mg * ratio ** p[0])


def _nodes(at: Place, p: Values) -> PathNodes:
    ratio = maximum(at.signal("rail_pressure_mpa"), RAIL_MIN_MPA) / REFERENCE_RAIL_MPA
    return at.changed(fuel_mg=at.of("fuel_mg") * ratio ** p[0])


EFFECT: Final = Effect(
    name="rail_exponent",
    says="injected mass follows rail pressure by another power",
    parameters=(Parameter("exponent", "-", -0.5, 0.5, (0.05,)),),
    needs=("rail_pressure_mpa",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes),
)
