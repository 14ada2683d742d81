"""Bounds and numbers of physical quantities that several effects use, see ``place.Place``."""

from typing import Final

FLOW_MIN_KG_H: Final = 3.0
SPEED_MIN_RPM: Final = 400.0  # of injection; below it the engine stands
STANDARD_KPA: Final = 101.3
KELVIN: Final = 273.15
GAS_KG_PER_M3: Final = 0.44  # exhaust at 800 K and ambient pressure
KG_PER_H_AND_LITRE_PER_S: Final = 3.6 * GAS_KG_PER_M3
AIR_FACTOR_MIN: Final = 0.5
AIR_FACTOR_MAX: Final = 2.0


def longest_passage_s(litres: float) -> float:
    """Return the time in s in which the least flow passes through a volume, 0 for none."""
    return max(litres, 0.0) * KG_PER_H_AND_LITRE_PER_S / FLOW_MIN_KG_H
