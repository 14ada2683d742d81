"""Effects of a healthy sensor that the chain leaves out."""

from dataclasses import replace

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.effect import Effect, Parameter, Signals, flow_kg_h

REFERENCE_KPA = 98.5


def _asymmetry(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """The sensor follows a rising phi (lean to rich) slower and a falling one faster."""
    return replace(
        path,
        sensor_rising_s=path.sensor_rising_s * np.exp(p[0]),
        sensor_falling_s=path.sensor_falling_s * np.exp(-p[0]),
    )


def _back_pressure(path: Path, p: FloatArray, signals: Signals, period_s: float) -> Path:
    """Exhaust pressure raises the sensor's sensitivity.

    The pressure at the sensor is ambient plus a drop with the square of the flow.
    """
    drop_kpa = 100.0 * (flow_kg_h(path, signals) / 200.0) ** 2
    above_kpa = drop_kpa + signals.get("ambient_pressure_kpa", REFERENCE_KPA) - REFERENCE_KPA
    return replace(path, span=path.span * np.clip(1.0 + p[0] * 0.01 * above_kpa, 0.1, 5.0))


EFFECTS = (
    Effect(
        "sensor_asymmetry",
        "the sensor follows one direction slower than the other",
        (Parameter("logarithm", "-", -2.5, 2.5, (0.3, -0.3)),),
        _asymmetry,
        (),
        "either",
        ("slow_rich_to_lean", "slow_lean_to_rich"),
    ),
    Effect(
        "back_pressure",
        "exhaust pressure raises the sensor's sensitivity",
        (Parameter("sensitivity", "1/bar", -2.0, 6.0, (0.3,), positive=True),),
        _back_pressure,
        ("engine_speed_rpm",),
        "physics",
    ),
)
