"""Effects of the simulated vehicle that a model may lack; a severity switches an effect on.

An effect of severity 1 moves the phi of the sensor by about the noise: 0.004 RMS outside fuel cut,
see ``tests/training/dyno/test_dyno_effects.py``. ``drive`` and ``mixture`` implement the effects
as maps over the operating point and as continuous dynamics.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from monitor.base.errors import UsageError


class Effects(NamedTuple):
    """Magnitude of every effect: its severity times ``SCALE``; 0 is absent."""

    wall_film: float = 0.0  # fraction of the fuel that wets the wall of a warm engine
    delay_flow: float = 0.0  # litres of exhaust volume between valve and sensor
    mix_flow: float = 0.0  # litres of well-mixed volume
    sensor_asymmetry: float = 0.0  # relative difference of the sensor's two time constants
    injector_offset: float = 0.0  # mg per stroke at short injections
    rail_exponent: float = 0.0  # deviation from the square root of the rail pressure
    maf_offset: float = 0.0  # kg/h
    maf_pulsation: float = 0.0  # relative error at the worst point
    purge: float = 0.0  # vapour concentration
    exhaust_leak: float = 0.0  # air drawn in at idle, as a fraction of the exhaust
    back_pressure: float = 0.0  # relative sensitivity per bar
    scavenging: float = 0.0  # fraction of the air at the worst point
    fuel_cut_tail: float = 0.0  # fall of phi after a long fuel cut
    charge_temperature: float = 0.0  # fraction of the wall's excess temperature
    manifold_filling: float = 0.0  # s, lag of the runner pressure at 1,500 rpm
    ethanol: float = 0.0  # fraction of ethanol
    oil_dilution: float = 0.0  # fuel vapour from the oil, mg/s
    battery_voltage: float = 0.0  # mg per stroke and volt
    intake_resonance: float = 0.0  # relative charge error on the resonance


SCALE = Effects(
    wall_film=0.032,
    delay_flow=0.82,
    mix_flow=0.88,
    sensor_asymmetry=0.54,
    injector_offset=0.04,
    rail_exponent=0.02,
    maf_offset=0.17,
    maf_pulsation=0.18,
    purge=0.21,
    exhaust_leak=0.0056,
    back_pressure=0.87,
    scavenging=0.12,
    fuel_cut_tail=0.075,
    charge_temperature=0.015,
    manifold_filling=0.0077,
    ethanol=0.01,
    oil_dilution=2.3,
    battery_voltage=0.073,
    intake_resonance=0.0086,
)
NAMES = Effects._fields


def from_severities(severities: Mapping[str, float]) -> Effects:
    """Return the effects with the given severities, name → severity.

    Raises UsageError for an unknown name or a severity that is negative or infinite.
    """
    for name, severity in severities.items():
        if name not in NAMES:
            raise UsageError(f"effect {name!r} is unknown; there are {', '.join(NAMES)}")
        if not 0.0 <= severity < math.inf:
            raise UsageError(f"effect {name}: severity {severity}, wanted 0 or more")
    scale = SCALE._asdict()
    return Effects(**{name: s * scale[name] for name, s in severities.items()})
