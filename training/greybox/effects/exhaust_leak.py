"""Exhaust leak: pulsation draws air in through a leak, and its share fades with the flow.

Air that enters near the valves (place 0) travels to the sensor with the exhaust; air that enters
at the sensor (place 1) is read at once.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.form.effect import Effect, GraphForm, Parameter, Signals, Values
from training.greybox.effects.form.place import PathNodes, Place
from training.greybox.effects.form.quantities import flow_kg_h
from training.greybox.effects.form.value import clip, exp

SHARE_MAX: Final = 0.5


def _arrays(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    fraction, fading_kg_h, place = p
    drawn = fraction * np.exp(-flow_kg_h(path, signals) / fading_kg_h)
    kept = 1.0 - np.clip(drawn, -SHARE_MAX, SHARE_MAX)
    return replace(
        path,
        factor=path.factor * kept ** (1.0 - place),
        gas_factor=path.gas_factor * kept**place,
    )


def _nodes(at: Place, p: Values) -> PathNodes:
    fraction, fading_kg_h, place = p
    drawn = fraction * exp(-at.flow_kg_h() / fading_kg_h)
    kept = 1.0 - clip(drawn, -SHARE_MAX, SHARE_MAX)
    return at.changed(
        factor=at.of("factor") * kept ** (1.0 - place),
        gas_factor=at.of("gas_factor") * kept**place,
    )


EFFECT: Final = Effect(
    name="exhaust_leak",
    says="a leak draws air into the exhaust at low flow",
    parameters=(
        Parameter("fraction", "-", -0.3, 0.4, (0.02,), positive=True),
        Parameter("fading", "kg/h", 8.0, 120.0, (20.0, 50.0)),
        Parameter("place", "-", 0.0, 1.0, (0.5,), spread=0.5),
    ),
    needs=("engine_speed_rpm",),
    tag="fault-like",
    apply=_arrays,
    graph=GraphForm(nodes=_nodes),
)
