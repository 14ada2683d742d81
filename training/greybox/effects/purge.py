"""Purge: fuel vapour of the canister comes with the purge air.

The vapour flow is its concentration times the valve's duty times the pressure drop to the
manifold, behind the lag of line and intake. Without a duty signal the valve is taken to be half
open while the engine is warm and driving.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.dynamics import lag
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import ambient_kpa, injecting, strokes_per_s
from training.greybox.effects.form.value import Value, maximum, where

VAPOUR_LAG_S: Final = 1.0  # canister line and intake
WARM_DEGC: Final = 60.0
DRIVING_RPM: Final = 1000.0
DUTY_PERCENT: Final = 50.0  # while the valve is taken to be open


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    drop_kpa = np.maximum(ambient_kpa(signals) - signals["manifold_pressure_kpa"], 0.0)
    duty = signals.get("purge_duty_percent")
    if duty is None:
        duty = DUTY_PERCENT * _allowed(signals)
    vapour_mg_s = lag(p[0] * 0.01 * duty * drop_kpa, VAPOUR_LAG_S, period_s)
    more = vapour_mg_s / strokes_per_s(signals) * injecting(signals)
    return replace(path, fuel_mg=path.fuel_mg + more)


def _allowed(signals: Signals) -> FloatArray:
    allowed = (signals["engine_speed_rpm"] > DRIVING_RPM) & injecting(signals)
    if "coolant_temperature_degc" in signals:
        allowed &= signals["coolant_temperature_degc"] > WARM_DEGC
    return allowed.astype(np.float64)


def _nodes(at: Place, p: Values) -> PathNodes:
    fuel = at.of("fuel_mg")
    drop_kpa = maximum(at.ambient_kpa() - at.signal("manifold_pressure_kpa"), 0.0)
    if "purge_duty_percent" in at.signals:
        duty = at.signal("purge_duty_percent")
    else:
        duty = where(_allowed_nodes(at), DUTY_PERCENT, 0.0)
    vapour_mg_s = at.lag(p[0] * 0.01 * duty * drop_kpa, VAPOUR_LAG_S)
    more = where(at.injecting(), vapour_mg_s / at.strokes_per_s(), 0.0)
    return at.changed(fuel_mg=fuel + more)


def _allowed_nodes(at: Place) -> Value:
    allowed = (at.signal("engine_speed_rpm") > DRIVING_RPM) & at.injecting()
    if "coolant_temperature_degc" in at.signals:
        allowed = allowed & (at.signal("coolant_temperature_degc") > WARM_DEGC)
    return allowed


EFFECT: Final = Effect(
    name="purge",
    says="canister purge brings fuel vapour",
    parameters=(Parameter("concentration", "mg/s/kPa", -2.0, 8.0, (0.3,), positive=True),),
    needs=("manifold_pressure_kpa", "engine_speed_rpm"),
    optional=("ambient_pressure_kpa", "purge_duty_percent", "coolant_temperature_degc"),
    superseded=(("coolant_temperature_degc", "purge_duty_percent"),),
    tag="physics",
    varies=True,
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, n_states=2),
)
