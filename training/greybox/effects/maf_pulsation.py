"""Air meter pulsation: the air meter reads too much at low speed and high load.

Air that flows back counts as air drawn in, so the error is never negative. Its form is a bump over
engine speed that grows with manifold pressure above 0.6 of ambient. The ECU's charge follows the
error up to a limit.
"""

from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.air_meter import (
    FOLLOWED,
    metered_kg_h,
    metered_nodes,
    taken_over,
)
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import air_times, ambient_kpa
from training.greybox.effects.form.value import exp, maximum, tanh

BUMP_RPM: Final = 450.0  # width over engine speed
LOAD_MIN: Final = 0.6  # manifold over ambient pressure


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    magnitude, centre_rpm, limit, followed_s = p
    bump = np.exp(-(((signals["engine_speed_rpm"] - centre_rpm) / BUMP_RPM) ** 2))
    load = np.maximum(signals["manifold_pressure_kpa"] / ambient_kpa(signals) - LOAD_MIN, 0.0)
    error_kg_h = magnitude * bump * load * metered_kg_h(signals)
    wrong = taken_over(error_kg_h, followed_s, signals, period_s)
    return air_times(path, 1.0 - limit * np.tanh(wrong / limit))


def _nodes(at: Place, p: Values) -> PathNodes:
    magnitude, centre_rpm, limit, followed_s = p
    off = (at.signal("engine_speed_rpm") - centre_rpm) / BUMP_RPM
    bump, metered = exp(-(off * off)), metered_nodes(at)
    load = maximum(at.signal("manifold_pressure_kpa") / at.ambient_kpa() - LOAD_MIN, 0.0)
    error_kg_h = at.lag(magnitude * bump * load * metered, followed_s)
    wrong = at.lag(error_kg_h / at.lag(metered, followed_s), followed_s)
    return at.air_times(1.0 - limit * tanh(wrong / limit))


EFFECT: Final = Effect(
    name="maf_pulsation",
    says="pulsation makes the air meter read too much",
    parameters=(
        Parameter("magnitude", "-", -1.0, 4.0, (0.2,), positive=True),
        Parameter("centre", "1/min", 800.0, 2500.0, (1200.0, 1800.0)),
        Parameter("limit", "-", 0.02, 0.5, (0.1,)),
        FOLLOWED,
    ),
    needs=("engine_speed_rpm", "manifold_pressure_kpa", "maf_kg_h"),
    optional=("ambient_pressure_kpa",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, n_states=4),
)
