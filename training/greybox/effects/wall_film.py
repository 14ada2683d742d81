"""Wall film: part of the fuel lands on the intake's walls and evaporates later, the X-tau model.

The film takes a share X of the fuel flow and gives it back with the time constant tau. Both grow
by ``cold_growth`` per 60 K below a warm engine.
Source: Aquino, Transient A/F control characteristics of the 5 liter central fuel injection engine,
SAE 810494.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.dynamics import lag
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import strokes_per_s
from training.greybox.effects.form.value import maximum, minimum

WARM_DEGC: Final = 80.0
SHARE_MAX: Final = 0.8


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    share, time_s, cold_growth = p
    coolant = signals.get("coolant_temperature_degc")
    cold = 0.0 if coolant is None else np.maximum(WARM_DEGC - coolant, 0.0) / 60.0
    grown = 1.0 + cold_growth * cold
    strokes = strokes_per_s(signals)
    landed = np.minimum(share * grown, SHARE_MAX) * path.fuel_mg
    evaporated = lag(landed * strokes, time_s * grown, period_s) / strokes
    return replace(path, fuel_mg=path.fuel_mg - landed + evaporated)


def _nodes(at: Place, p: Values) -> PathNodes:
    share, time_s, cold_growth = p
    fuel, grown = at.of("fuel_mg"), None
    if "coolant_temperature_degc" in at.signals:
        cold = maximum(WARM_DEGC - at.signal("coolant_temperature_degc"), 0.0) / 60.0
        grown = 1.0 + cold_growth * cold
    strokes = at.strokes_per_s()
    landed = fuel * (min(share, SHARE_MAX) if grown is None else minimum(share * grown, SHARE_MAX))
    lag_s = time_s if grown is None else time_s * grown
    evaporated = at.lag(landed * strokes, lag_s) / strokes
    return at.changed(fuel_mg=fuel - landed + evaporated)


EFFECT: Final = Effect(
    name="wall_film",
    says="part of the fuel lands on walls and evaporates later",
    parameters=(
        Parameter("share", "-", -0.1, 0.6, (0.1,), positive=True),
        Parameter("time", "s", 0.1, 4.0, (0.4, 1.2)),
        Parameter("cold_growth", "-", 0.0, 4.0, (1.0,), spread=1.0),
    ),
    needs=("engine_speed_rpm",),
    optional=("coolant_temperature_degc",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, n_states=2),
)
