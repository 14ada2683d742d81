"""Sensor faults as pure transforms of phi = 1/lambda, sample by sample.

Phi rises from lean to rich. With u the reading of the healthy and s of the faulty sensor:

- lag: dx/dt = (u - x) / tau; the direction of u - x chooses tau;
- dead time d: s(t) = min(u(t), u(t - d)) on rising edges, max(u(t), u(t - d)) on falling edges,
  u(t - d) on both;
- gain: s = 1 + g (u - 1);
- offset: added in lambda; a drift is an offset that grows for half an hour and then stays;
- holds: the last reading again for the first seconds of every twelve;
- ripple: what a dead sensor reads beside its constant.

The scalar steps are plain functions: the simulated dynamometer compiles the same code into its
control loop. ``fault_streams`` applies them to readings one after the other.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from monitor.base.errors import UsageError

RICH_TO_LEAN, LEAN_TO_RICH, SYMMETRIC = -1, 1, 0

TRANSIENT_GAIN = 0.7  # amplitude of the transient fault; its severity is the lag
HOLD_EVERY_S = 12.0  # from one hold of an intermittent sensor to the next
DRIFT_S = 1800.0  # after which a drift has its whole size
OUT_OF_RANGE_LAMBDA = 0.31  # no wideband sensor can read so low a lambda
ALONE = 1.0  # severity of a fault that is there or not


def lag_step(x: float, u: float, tau_rising_s: float, tau_falling_s: float, step_s: float) -> float:
    """Return the lagged value one step later, exact for a constant ``u``."""
    tau_s = tau_rising_s if u > x else tau_falling_s
    if tau_s <= 0.0:
        return u
    return x + (u - x) * (1.0 - math.exp(-step_s / tau_s))


def aged(
    reading: float,
    last: float,
    t_s: float,
    ripple_lambda: float,
    drift_lambda: float,
    hold_s: float,
) -> float:
    """Return a reading in lambda with noise, drift and holds.

    last : reading before, NaN at the beginning
    t_s : since the fault began
    The noise follows from the time: its low digits are as good as random, and a generator with a
    state could not be compiled into the plant's loop.
    """
    if hold_s > 0.0 and t_s % HOLD_EVERY_S < hold_s and not math.isnan(last):
        return last
    if ripple_lambda > 0.0:
        beyond = math.sin(t_s * 1299.8) * 43758.5453
        reading += ripple_lambda * math.sqrt(12.0) * (beyond - math.floor(beyond) - 0.5)
    return reading + drift_lambda * min(t_s / DRIFT_S, 1.0)


def one_sided(u: float, delayed: float, direction: int) -> float:
    """Return the reading of a sensor with dead time on one edge direction, or on both."""
    if direction > 0:
        return min(u, delayed)
    if direction < 0:
        return max(u, delayed)
    return delayed


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault by name, with the parameters of its transform."""

    name: str
    severity: float
    tau_rising_s: float = 0.0
    tau_falling_s: float = 0.0
    delay_s: float = 0.0
    delay_direction: int = SYMMETRIC
    gain: float = 1.0
    offset_lambda: float = 0.0
    stuck_lambda: float = 0.0  # 0: not stuck
    ripple_lambda: float = 0.0  # standard deviation of noise beside the stuck reading
    drift_lambda: float = 0.0  # offset after DRIFT_S
    hold_s: float = 0.0  # of every HOLD_EVERY_S
    not_ready: bool = False
    heater_dead: bool = False
    missing: bool = False


DEFAULT_SEVERITY = {
    "slow_rich_to_lean": 0.6,
    "slow_lean_to_rich": 0.6,
    "slow_symmetric": 0.6,
    "delay_rich_to_lean": 0.6,
    "delay_lean_to_rich": 0.6,
    "delay_symmetric": 0.6,
    "transient": 0.6,
    "gain_low": 0.5,
    "biased_lean": 0.1,
    "biased_rich": 0.1,
    "stuck_lean": 0.15,
    "stuck_rich": 0.15,
    "stuck_at_one": ALONE,
    "not_ready": ALONE,
    "out_of_range": OUT_OF_RANGE_LAMBDA,
    "signal_missing": ALONE,
    "no_activity": 0.003,
    "intermittent": 3.0,
    "drift_lean": 0.15,
    "drift_rich": 0.15,
    "heater": ALONE,
}
NAMES = tuple(DEFAULT_SEVERITY)


def severity_of(name: str, given: float | None, usual: Mapping[str, float]) -> float:
    """Return the severity of a fault, without one the usual; raises UsageError as ``resolve``."""
    if name not in usual:
        raise UsageError(f"fault {name!r} is unknown; there are {', '.join(usual)}")
    severity = usual[name] if given is None else float(given)
    if not 1e-9 <= severity <= 1e6:  # beyond, times in ns overflow
        raise UsageError(f"fault {name}: severity {severity:g} is not within 1e-9 to 1e6")
    return severity


def resolve(name: str, severity: float | None = None) -> Fault:
    """Return the fault of a name; without a severity, ``DEFAULT_SEVERITY`` holds.

    severity : time constant or dead time in s, gain, or offset in lambda; out_of_range: the lambda
        that is sent; stuck_lean and stuck_rich: the distance of the frozen value from lambda 1;
        no_activity: noise of a dead sensor at lambda 1; intermittent: length of the holds in s;
        drift_lean and drift_rich: offset in lambda after half an hour
    Raises UsageError if the name is unknown or the severity impossible.
    """
    s = severity_of(name, severity, DEFAULT_SEVERITY)
    if DEFAULT_SEVERITY[name] == ALONE != s:
        raise UsageError(f"fault {name}: severity {s:g}, none is wanted")
    if name == "gain_low" and s >= 1.0:
        raise UsageError(f"fault gain_low: severity {s} is the gain that is left, wanted below 1")
    if name == "intermittent" and s >= HOLD_EVERY_S:
        raise UsageError(f"fault intermittent: holds of {s} s, below {HOLD_EVERY_S:g} are wanted")
    kind, _, direction = name.partition("_")
    if kind == "slow":
        rising = s if direction != "rich_to_lean" else 0.0
        falling = s if direction != "lean_to_rich" else 0.0
        return Fault(name, s, tau_rising_s=rising, tau_falling_s=falling)
    if kind == "delay":
        sides = {"rich_to_lean": RICH_TO_LEAN, "lean_to_rich": LEAN_TO_RICH, "symmetric": SYMMETRIC}
        return Fault(name, s, delay_s=s, delay_direction=sides[direction])
    return {
        "transient": Fault(name, s, tau_rising_s=s, tau_falling_s=s, gain=TRANSIENT_GAIN),
        "gain_low": Fault(name, s, gain=s),
        "biased_lean": Fault(name, s, offset_lambda=s),
        "biased_rich": Fault(name, s, offset_lambda=-s),
        "stuck_lean": Fault(name, s, stuck_lambda=1.0 + s),
        "stuck_rich": Fault(name, s, stuck_lambda=max(1.0 - s, 0.5)),
        "stuck_at_one": Fault(name, s, stuck_lambda=1.0),
        "no_activity": Fault(name, s, stuck_lambda=1.0, ripple_lambda=s),
        "intermittent": Fault(name, s, hold_s=s),
        "drift_lean": Fault(name, s, drift_lambda=s),
        "drift_rich": Fault(name, s, drift_lambda=-s),
        "not_ready": Fault(name, s, not_ready=True),
        "heater": Fault(name, s, not_ready=True, heater_dead=True),
        "out_of_range": Fault(name, s, stuck_lambda=s),
        "signal_missing": Fault(name, s, missing=True),
    }[name]


# Disturbances of the sensor signal. They are random and have no trouble code.
DEFAULT_DISTURBANCE = {"noise": 0.02, "drop_outs": 0.1}
DROP_OUT_S = 0.3  # mean length of a drop-out
