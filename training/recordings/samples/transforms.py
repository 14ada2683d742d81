"""Transforms of inputs, fixed instead of learned; they are part of the graph.

``ratio``: the numerator's place is taken by factor * numerator / denominator, clipped. With fuel
over air and the stoichiometric ratio this is the phi that was injected. On simulated drives the
free run was as good without it (fit 81.6 % either way), so it is used on request only.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.base.types import FloatArray

STOICHIOMETRIC = 14.7  # air to fuel by mass; any constant will do, the network scales it
RATIO_MAX = 2.5
AIR_MIN_MG = 1.0


def fuel_air_ratio() -> Mapping[str, Any]:
    """Return the card entry of the transform for fuel_mass_mg and air_mass_mg."""
    return {
        "kind": "ratio",
        "numerator": "fuel_mass_mg",
        "denominator": "air_mass_mg",
        "factor": STOICHIOMETRIC,
        "denominator_minimum": AIR_MIN_MG,
        "maximum": RATIO_MAX,
    }


def apply(
    transforms: Sequence[Mapping[str, Any]], names: Sequence[str], u: FloatArray
) -> FloatArray:
    """Return the inputs (n, k) that the network sees for physical inputs ``u`` (n, k)."""
    result = u.copy()
    order = list(names)
    for t in transforms:
        i, j = order.index(t["numerator"]), order.index(t["denominator"])
        below = np.maximum(u[:, j], t["denominator_minimum"])
        result[:, i] = np.clip(t["factor"] * u[:, i] / below, 0.0, t["maximum"])
    return result
