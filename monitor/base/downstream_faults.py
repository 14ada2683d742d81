"""Faults behind the upstream sensor: the catalyst, and the switching sensor downstream of it.

They have no transform of lambda: the simulated dynamometer puts them into the plant. Names, units
and default severities stand here, so that commands and reports share them.
"""

from dataclasses import dataclass
from typing import Final

from monitor.base.errors import UsageError
from monitor.base.faults import severity_of

CATALYST: Final = "catalyst_low"
_SLOW_S, _LATE_S = 1.5, 1.5
DEFAULT_SEVERITY: Final[dict[str, float]] = {
    CATALYST: 0.06,  # g of oxygen that the catalyst stores
    "downstream_slow_rich_to_lean": _SLOW_S,  # time constant in s
    "downstream_slow_lean_to_rich": _SLOW_S,
    "downstream_slow_symmetric": _SLOW_S,
    "downstream_delay_rich_to_lean": _LATE_S,  # dead time in s
    "downstream_delay_lean_to_rich": _LATE_S,
    "downstream_delay_symmetric": _LATE_S,
    "downstream_weak": 0.4,  # part of the amplitude that is left
    "downstream_stuck_lean": 0.1,  # V
    "downstream_stuck_rich": 0.8,  # V
    "downstream_low": 0.01,  # V: shorted to ground
    "downstream_high": 1.4,  # V: shorted to the supply
    "downstream_inactive": 0.45,  # V: an open circuit rests at the ECU's own voltage
    "downstream_heater": 0.05,  # part of the heating power that is left
}
NAMES: Final = tuple(DEFAULT_SEVERITY)
_PARTS: Final = ("downstream_weak", "downstream_heater")
_PARAMETERS: Final = {CATALYST: "capacity_g", _PARTS[0]: "gain", _PARTS[1]: "heating"}
_HELD: Final = tuple(f"downstream_{kind}" for kind in ("stuck", "low", "high", "inactive"))


@dataclass(frozen=True, slots=True)
class DownstreamFault:
    """A fault of catalyst or downstream sensor, with the parameters that the plant takes."""

    name: str
    severity: float
    capacity_g: float = 0.0  # 0: the vehicle's own catalyst
    tau_to_rich_s: float = 0.0  # added to the sensor's lag
    tau_to_lean_s: float = 0.0
    delay_to_rich_s: float = 0.0
    delay_to_lean_s: float = 0.0
    gain: float = 1.0
    stuck_v: float = 0.0  # 0: not stuck
    heating: float = 1.0  # part of the heating power that is left
    leak: float = 0.0  # air drawn in between the sensors at idle, as a part of the exhaust
    sulphur: float = 0.0  # part of the capacity that sulphur blocks until hot rich gas takes it

    @property
    def suits_wide(self) -> bool:
        """Return whether a wide-range sensor can have the fault: it needs no voltage."""
        return self.gain == self.heating == 1.0 and self.stuck_v == 0.0


def resolve(name: str, severity: float | None = None) -> DownstreamFault:
    """Return the fault of a name; without a severity, ``DEFAULT_SEVERITY`` holds.

    severity : g (catalyst_low), s (slow, delay), part of the amplitude (weak), V (stuck, low, high,
        inactive) or part of the heating power (heater)
    Raises UsageError if the name is unknown or the severity impossible.

    >>> resolve("catalyst_low", 0.03).capacity_g
    0.03
    """
    s = severity_of(name, severity, DEFAULT_SEVERITY)
    if name in _PARTS and s >= 1.0:
        raise UsageError(f"fault {name}: severity {s} is the part that is left, wanted below 1")
    if name in _PARAMETERS:
        return DownstreamFault(name, s, **{_PARAMETERS[name]: s})
    if name.startswith(_HELD):
        return DownstreamFault(name, s, stuck_v=s)
    to_rich = s if not name.endswith("rich_to_lean") else 0.0
    to_lean = s if not name.endswith("lean_to_rich") else 0.0
    if "_slow_" in name:
        return DownstreamFault(name, s, tau_to_rich_s=to_rich, tau_to_lean_s=to_lean)
    return DownstreamFault(name, s, delay_to_rich_s=to_rich, delay_to_lean_s=to_lean)
