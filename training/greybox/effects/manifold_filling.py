"""Manifold filling: the runner fills later than the manifold's sensor says.

The charge follows with a time constant in inverse proportion to engine speed. It follows in its
logarithm: slower up and faster down than in mass. A time below 0 is an ECU whose estimate of the
filling is late, so that the charge is ahead of it.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import AIR_LEAST_MG, Path
from training.greybox.effects.form.dynamics import ramp_lag
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.value import maximum

REFERENCE_RPM: Final = 1500.0  # at which the time constant is the parameter
FILLING_MIN_RPM: Final = 500.0


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    rpm = np.maximum(signals["engine_speed_rpm"], FILLING_MIN_RPM)
    charge = np.log(np.maximum(path.air_mg, AIR_LEAST_MG))
    late = ramp_lag(charge, abs(p[0]) * REFERENCE_RPM / rpm, period_s)
    return replace(path, air_mg=np.exp(late if p[0] >= 0.0 else 2.0 * charge - late))


def _nodes(at: Place, p: Values) -> PathNodes:
    time_s = abs(p[0]) * REFERENCE_RPM / maximum(at.signal("engine_speed_rpm"), FILLING_MIN_RPM)
    charge = maximum(at.of("air_mg"), AIR_LEAST_MG)
    late = at.ramp_lag_in_proportion(charge, time_s)
    return at.changed(air_mg=late if p[0] >= 0.0 else charge * charge / late)


EFFECT: Final = Effect(
    name="manifold_filling",
    says="the charge is later or earlier than broadcast while load moves",
    parameters=(Parameter("time", "s", -0.4, 0.4, (0.02, -0.02), least=0.005),),
    needs=("engine_speed_rpm",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, n_states=3),
)
