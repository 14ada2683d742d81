"""Catalyst, downstream sensor and outer trim of one vehicle: its constants and its state."""

from typing import Final, NamedTuple

import numpy as np

from monitor.base.downstream_faults import DownstreamFault


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
        sulphur=0.0,
        leak=0.0,
        tau_to_rich_s=0.0,
        tau_to_lean_s=0.0,
        delay_to_rich_s=0.0,
        delay_to_lean_s=0.0,
        gain=1.0,
        stuck_v=0.0,
        heating=1.0,
        start_s=np.inf,
        wide=0.0,
        wide_offset=0.002 * u[10],
        steps=0.0,
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
    return own._replace(
        capacity_g=fault.capacity_g or own.capacity_g,
        tau_to_rich_s=fault.tau_to_rich_s,
        tau_to_lean_s=fault.tau_to_lean_s,
        delay_to_rich_s=fault.delay_to_rich_s,
        delay_to_lean_s=fault.delay_to_lean_s,
        gain=fault.gain,
        stuck_v=fault.stuck_v,
        heating=fault.heating,
        leak=fault.leak,
        sulphur=fault.sulphur,
        start_s=start_s,
    )


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
