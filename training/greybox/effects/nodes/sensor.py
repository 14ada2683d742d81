"""Effects of a healthy sensor, as ``effects.sensor`` has them."""

import math

from training.greybox.effects.nodes.form import Form, Parameters
from training.greybox.effects.nodes.place import Place
from training.greybox.effects.nodes.value import clip
from training.greybox.effects.sensor import REFERENCE_KPA
from training.greybox.graph.nodes import Nodes


def _asymmetry(at: Place, p: Parameters) -> Nodes:
    return at.changed(
        sensor_rising_s=at.of("sensor_rising_s") * math.exp(p[0]),
        sensor_falling_s=at.of("sensor_falling_s") * math.exp(-p[0]),
    )


def _back_pressure(at: Place, p: Parameters) -> Nodes:
    relative = at.flow_kg_h() / 200.0
    drop_kpa = 100.0 * (relative * relative)
    above_kpa = drop_kpa + (at.ambient_kpa(without=REFERENCE_KPA) - REFERENCE_KPA)
    return at.changed(span=at.of("span") * clip(1.0 + 0.01 * p[0] * above_kpa, 0.1, 5.0))


FORMS = {
    "sensor_asymmetry": Form(_asymmetry, slower=lambda p: math.exp(abs(p[0])) - 1.0),
    "back_pressure": Form(_back_pressure, optional=("ambient_pressure_kpa",)),
}
