"""Catalyst, downstream sensor and outer trim of one vehicle: its constants and its state."""

from dataclasses import asdict, dataclass
from typing import Final, NamedTuple

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.faults import severity_of

# Faults of catalyst and downstream sensor; they have no transform of lambda.
CATALYST_FAULT: Final = "catalyst_low"
_SLOW_S, _LATE_S = 1.5, 1.5
USUAL_SEVERITY: Final[dict[str, float]] = {
    CATALYST_FAULT: 0.06,  # g of oxygen that the catalyst stores
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
FAULTS: Final = tuple(USUAL_SEVERITY)
_PARTS: Final = ("downstream_weak", "downstream_heater")
_PARAMETERS: Final = {CATALYST_FAULT: "capacity_g", _PARTS[0]: "gain", _PARTS[1]: "heating"}
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

    @property
    def parameters(self) -> dict[str, float]:
        """Return what the plant takes, the capacity only if it is not the vehicle's own."""
        own = asdict(self)
        left_out = ("name", "severity") if self.capacity_g else ("name", "severity", "capacity_g")
        return {name: own[name] for name in own if name not in left_out}


def fault_behind(name: str, severity: float | None = None) -> DownstreamFault:
    """Return the fault of a name; without a severity, ``USUAL_SEVERITY`` holds.

    severity : g (catalyst_low), s (slow, delay), part of the amplitude (weak), V (stuck, low, high,
        inactive) or part of the heating power (heater)
    Raises UsageError if the name is unknown or the severity impossible.

    >>> fault_behind("catalyst_low", 0.03).capacity_g
    0.03
    """
    s = severity_of(name, severity, USUAL_SEVERITY)
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


class Downstream(NamedTuple):
    """Catalyst, downstream sensor and outer trim of one vehicle, as plain numbers."""

    active: float  # 0: the vehicle has none of it
    capacity_g: float  # of oxygen, warm
    fill_half: float  # part of a cell's room at which rho is 1/2
    release_half: float  # the same of its filling, without sulphur; larger: release is slower
    flow_g_s: float  # air flow at which the gas stays so short that rho falls to 63 %
    hydrogen: float  # shift of the switching point by hydrogen, in x
    equilibrium: float  # x of the gas over a last cell that is full, or empty (negative)
    width: float  # of the switching characteristic, in x
    low_v: float
    span_v: float
    pipe_l: float  # from the catalyst to the sensor
    brick_start_degc: float
    sulphur: float  # part of the capacity that sulphur blocks at the start
    leak: float  # air drawn in between the sensors at idle, as a part of the exhaust
    tau_to_rich_s: float  # fault: added lag
    tau_to_lean_s: float
    delay_to_rich_s: float  # fault: dead time
    delay_to_lean_s: float
    gain: float  # fault: part of the amplitude that is left
    stuck_v: float  # fault: frozen voltage, 0 is none
    heating: float  # fault: part of the heating power that is left
    start_s: float  # of a fault of the sensor
    wide: float  # 1: a sensor of wide range, whose reading the ECU turns into volts
    wide_offset: float  # of such a sensor, in x
    steps: float  # active steps of the commanded phi, one side; 0: the ECU makes none


NONE: Final = Downstream(*([0.0] * len(Downstream._fields)))


class Brick(NamedTuple):
    """State of brick, pipe, sensor and outer trim."""

    degc: float
    x_out: float  # of the gas that leaves the catalyst
    x_pipe: float  # of the gas at the sensor
    reading: float  # behind the sensor's lag: richness, 0 to 1; of a wide-range sensor -x
    volts: float
    trim: float  # added to the commanded phi
    integral: float
    heater: float  # duty, 0 to 1
    tip_degc: float  # of the sensor
    step: float  # of an active test: 1 rich, -1 lean, 0 none
    step_s: float  # since the half period began; between tests, since the engine is steady
    halves: float  # half periods so far
    sulphur: float  # part of the capacity that sulphur blocks
    refill: float  # 1 while the ECU enriches after a fuel cut, until the sensor reads rich


def piece(vehicle: int) -> Downstream:
    """Return the catalyst and sensor of the vehicle with this number, within production spread."""
    rng = np.random.default_rng([0x0_2, 6, vehicle])
    u = rng.uniform(-1.0, 1.0, 11)
    return Downstream(
        active=1.0,
        capacity_g=float(0.55 * np.exp(0.5 * u[0])),  # full useful life to fresh, 0.33 to 0.9
        fill_half=0.08 * (1.0 + 0.3 * u[1]),
        release_half=0.16 * (1.0 + 0.3 * u[2]),
        flow_g_s=90.0 * (1.0 + 0.2 * u[3]),
        hydrogen=0.0011 * (1.0 + 0.25 * u[4]),
        equilibrium=0.0014 * (1.0 + 0.3 * u[9]),
        width=0.0012 * (1.0 + 0.3 * u[5]),
        low_v=0.07 + 0.02 * u[6],
        span_v=0.76 + 0.04 * u[7],
        pipe_l=1.0 * (1.0 + 0.3 * u[8]),
        brick_start_degc=0.0,
        start_s=np.inf,
        wide=0.0,
        wide_offset=0.002 * u[10],
        steps=0.0,
        **DownstreamFault("", 0.0).parameters,
    )


def installed(
    vehicle: int,
    fault: DownstreamFault | None,
    start_s: float,
    brick_start_degc: float,
    steps_phi: float = 0.0,
    *,
    wide: bool = False,
) -> Downstream:
    """Return the vehicle's catalyst and sensor with a fault; a catalyst is bad from the start."""
    own = piece(vehicle)._replace(
        brick_start_degc=brick_start_degc, steps=steps_phi, wide=float(wide)
    )
    if fault is None:
        return own
    return own._replace(start_s=start_s, **fault.parameters)


def begin(d: Downstream, warm: float) -> Brick:
    """Return the state at engine start; ``warm`` 0 to 1 is the remaining warmth of a hot brick."""
    return Brick(
        degc=d.brick_start_degc + warm * 280.0,
        x_out=0.0,
        x_pipe=0.0,
        reading=0.5 - 0.5 * d.wide,
        volts=0.45,
        trim=0.0,
        integral=0.0,
        heater=1.0,
        tip_degc=d.brick_start_degc + warm * 200.0,
        step=0.0,
        step_s=0.0,
        halves=0.0,
        sulphur=d.sulphur,
        refill=0.0,
    )
