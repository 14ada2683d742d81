"""Fuel cut tail: after a fuel cut the gas stays lean for a while.

Air leaves a dead volume, and walls are dry. The cut fills a store, which empties afterwards in a
time over a power of the exhaust's flow: power 1 is a volume that is washed out, power 0 a constant
time.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.dynamics import lag
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import FLOW_MIN_KG_H, flow_kg_h, injecting
from training.greybox.effects.form.value import maximum, where

REFERENCE_FLOW_KG_H: Final = 20.0  # at which the tail's time is the parameter
FACTOR_MIN: Final = 0.2


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    depth, time_s, exponent = p
    cut = ~injecting(signals)
    emptied_s = time_s * (REFERENCE_FLOW_KG_H / flow_kg_h(path, signals)) ** exponent
    tail = lag(cut.astype(np.float64), emptied_s, period_s)
    kept = np.maximum(1.0 - depth * tail * ~cut, FACTOR_MIN)
    return replace(path, gas_factor=path.gas_factor * kept)


def _nodes(at: Place, p: Values) -> PathNodes:
    depth, time_s, exponent = p
    runs = at.injecting()
    cut = where(runs, 0.0, 1.0)
    tail = at.lag(cut, time_s * (REFERENCE_FLOW_KG_H / at.flow_kg_h()) ** exponent)
    kept = maximum(1.0 - depth * where(runs, tail, 0.0), FACTOR_MIN)
    return at.changed(gas_factor=at.of("gas_factor") * kept)


def _longest_s(p: Values) -> float:
    """Return the time in s in which a tail empties at the least flow."""
    return p[1] * (REFERENCE_FLOW_KG_H / FLOW_MIN_KG_H) ** p[2]


EFFECT: Final = Effect(
    name="fuel_cut_tail",
    says="the exhaust stays lean after a fuel cut",
    parameters=(
        Parameter("depth", "-", -0.5, 2.0, (0.05,), positive=True),
        Parameter("time", "s", 0.2, 8.0, (2.0,)),
        Parameter("exponent", "-", 0.0, 1.0, (0.5,), spread=0.5),
    ),
    needs=("engine_speed_rpm",),
    tag="physics",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes, n_states=2, lag_s=_longest_s),
)
