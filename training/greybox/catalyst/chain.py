"""A catalyst and its downstream sensor with ten constants, as one compiled loop.

With x = 1 - 1/lambda + offset, oxygen enters at 0.23 · air flow · x. ``CELLS`` equal cells follow
each other. The part f^fill of lean gas passes a cell that is filled to the part f, and
(1 - f)^release of rich gas; the rest is stored as far as there is room (Brandt, Wang and Grizzle,
IEEE Trans. Control Systems Technology 8, 2000). The gas over the last cell is lean where that is
full and rich where it is empty. A switching sensor sees the gas with a dead time, a shift by
hydrogen and a lag per direction (Auckenthaler, ETH 16018, 2005).
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit

from monitor.base.types import FloatArray

CELLS: Final = 4
SUBSTEPS: Final = 4  # of a sample: a small cell fills within one
OXYGEN_IN_AIR: Final = 0.23  # mass fraction
EQUILIBRIUM_PHI: Final = 0.0014  # x over a full last cell, and its negative over an empty one
WIDTH_PHI: Final = 0.0015  # of the switching characteristic
X_MOST: Final = 0.999


class Catalyst(NamedTuple):
    """The constants."""

    capacity_g: float = 0.3
    fill: float = 5.0
    release: float = 5.0
    offset_phi: float = 0.0  # added to the upstream reading
    hydrogen_phi: float = 0.001
    delay_s: float = 0.1
    to_rich_s: float = 0.1
    to_lean_s: float = 0.15
    low_v: float = 0.07
    span_v: float = 0.72


class CatalystRange(NamedTuple):
    """Unit, bounds and form of a constant."""

    unit: str
    low: float
    high: float
    is_log: bool  # fitted as its logarithm


RANGES: Final[dict[str, CatalystRange]] = {  # of each constant, in the order of ``Catalyst``
    "capacity_g": CatalystRange("g", 0.005, 3.0, is_log=True),
    "fill": CatalystRange("", 0.5, 30.0, is_log=True),
    "release": CatalystRange("", 0.5, 30.0, is_log=True),
    "offset_phi": CatalystRange("1 - 1/lambda", -0.06, 0.06, is_log=False),
    "hydrogen_phi": CatalystRange("1 - 1/lambda", -0.003, 0.005, is_log=False),
    "delay_s": CatalystRange("s", 0.0, 2.5, is_log=False),
    "to_rich_s": CatalystRange("s", 0.01, 4.0, is_log=True),
    "to_lean_s": CatalystRange("s", 0.01, 4.0, is_log=True),
    "low_v": CatalystRange("V", -0.1, 0.45, is_log=False),
    "span_v": CatalystRange("V", 0.05, 1.2, is_log=False),
}


@njit(cache=True)
def volts(x: FloatArray, air_g_s: FloatArray, period_s: float, c: Catalyst) -> FloatArray:
    """Return the voltage, (n,), of a catalyst that begins half full.

    x : (n,) 1 - 1/lambda upstream; air_g_s : (n,)
    """
    n, step_s = len(x), period_s / SUBSTEPS
    room = c.capacity_g / CELLS
    held = np.full(CELLS, 0.5)
    steady, out = np.full(n, 0.5), np.empty(n)
    late = c.delay_s / period_s
    whole = int(late)
    part = late - whole
    rich = 0.5
    for k in range(n):
        entering = min(x[k] + c.offset_phi, X_MOST)
        seen = 0.0
        mass = max(OXYGEN_IN_AIR * air_g_s[k] * step_s, 1e-9)
        for _ in range(SUBSTEPS):
            gas = entering
            for j in range(CELLS):
                f = held[j]
                if gas > 0.0:
                    taken = min(mass * gas * (1.0 - f**c.fill), (1.0 - f) * room)
                else:
                    taken = max(mass * gas * (1.0 - (1.0 - f) ** c.release), -f * room)
                held[j] = min(max(f + taken / room, 0.0), 1.0)
                gas -= taken / mass
            seen += gas / SUBSTEPS
        seen += EQUILIBRIUM_PHI * (2.0 * held[CELLS - 1] - 1.0) - c.hydrogen_phi
        steady[k] = 0.5 - 0.5 * np.tanh(seen / (2.0 * WIDTH_PHI))
        near, far = max(k - whole, 0), max(k - whole - 1, 0)
        now = (1.0 - part) * steady[near] + part * steady[far]
        tau_s = c.to_rich_s if now > rich else c.to_lean_s
        rich += (now - rich) * (1.0 - np.exp(-period_s / tau_s))
        out[k] = c.low_v + c.span_v * rich
    return out
