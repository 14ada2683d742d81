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
control loop. ``SensorFault`` applies them to a stream.
"""

import math
import random
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from monitor.base.errors import UsageError

RICH_TO_LEAN, LEAN_TO_RICH, SYMMETRIC = -1, 1, 0

TRANSIENT_GAIN = 0.7  # amplitude of the transient fault; its severity is the lag
HOLD_EVERY_S = 12.0  # from one hold of an intermittent sensor to the next
DRIFT_S = 1800.0  # after which a drift has its whole size
OUT_OF_RANGE_LAMBDA = 0.31  # no wideband sensor can read so low a lambda


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
    missing: bool = False


_STUCK_STEP = 0.15
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
    "stuck_lean": _STUCK_STEP,
    "stuck_rich": _STUCK_STEP,
    "stuck_at_one": 1.0,
    "not_ready": 1.0,
    "out_of_range": OUT_OF_RANGE_LAMBDA,
    "signal_missing": 1.0,
    "no_activity": 0.003,
    "intermittent": 3.0,
    "drift_lean": 0.15,
    "drift_rich": 0.15,
}
NAMES = tuple(DEFAULT_SEVERITY)


def resolve(name: str, severity: float | None = None) -> Fault:
    """Return the fault of a name; without a severity, ``DEFAULT_SEVERITY`` holds.

    severity : time constant or dead time in s, gain, or offset in lambda; out_of_range: the lambda
        that is sent; stuck_lean and stuck_rich: the distance of the frozen value from lambda 1;
        no_activity: noise of a dead sensor at lambda 1; intermittent: length of the holds in s;
        drift_lean and drift_rich: offset in lambda after half an hour
    Raises UsageError if the name is unknown or the severity impossible.
    """
    if name not in DEFAULT_SEVERITY:
        raise UsageError(f"fault {name!r} is unknown; there are {', '.join(NAMES)}")
    s = DEFAULT_SEVERITY[name] if severity is None else float(severity)
    if not math.isfinite(s) or s <= 0.0:
        raise UsageError(f"fault {name}: severity {s} is not positive")
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
        "out_of_range": Fault(name, s, stuck_lambda=s),
        "signal_missing": Fault(name, s, missing=True),
    }[name]


def combine(parts: Sequence[Fault]) -> Fault | None:
    """Return one fault with the effects of all parts; None if there are no parts.

    Raises UsageError if two parts set the same parameter.
    """
    if len(parts) < 2:
        return parts[0] if parts else None
    healthy = Fault("", 0.0)
    values: dict[str, Any] = {}
    for part in parts:
        for field in fields(Fault)[2:]:
            value = getattr(part, field.name)
            changed = value != getattr(healthy, field.name)
            if changed and values.setdefault(field.name, value) != value:
                raise UsageError(f"faults {[p.name for p in parts]} both set {field.name}")
    return Fault("+".join(p.name for p in parts), parts[0].severity, **values)


class SensorFault:
    """A fault on a stream of lambda readings, behind the control loop.

    Communication faults (not_ready, signal_missing) read NaN here.
    """

    def __init__(self, fault: Fault, period_s: float) -> None:
        self._fault = fault
        self._period_s = period_s
        self._history: deque[float] = deque(maxlen=round(fault.delay_s / period_s) + 1)
        self._x = self._last = math.nan
        self._n = -1

    def push(self, lambda_healthy: float) -> float:
        """Return the faulty reading in lambda; NaN stays NaN, values of 0 and below stay."""
        reading = self._followed(lambda_healthy)
        if _is_none(reading):
            return reading
        self._n += not _is_none(lambda_healthy)
        self._last = _aged(self._fault, reading, self._last, self._n * self._period_s)
        return self._last

    def _followed(self, lambda_healthy: float) -> float:
        fault = self._fault
        at_once = _at_once(fault, lambda_healthy)
        if at_once is not None:
            return at_once
        phi = 1.0 / lambda_healthy
        self._history.append(phi)
        phi = one_sided(phi, self._history[0], fault.delay_direction)
        if math.isnan(self._x):
            self._x = phi
        self._x = lag_step(self._x, phi, fault.tau_rising_s, fault.tau_falling_s, self._period_s)
        return _reading(fault, self._x)

    def apply(self, lambda_healthy: Iterable[float]) -> list[float]:
        """Return the faulty readings of a whole series."""
        return [self.push(value) for value in lambda_healthy]


def _at_once(fault: Fault, lambda_healthy: float) -> float | None:
    """Return the reading if it does not depend on earlier readings, otherwise None."""
    if not math.isfinite(lambda_healthy) or fault.not_ready or fault.missing:
        return math.nan
    if fault.stuck_lambda:
        return fault.stuck_lambda
    return lambda_healthy if lambda_healthy <= 0.0 else None


def _reading(fault: Fault, x: float) -> float:
    """Return the lambda reading for ``x``, which is phi after dead time and lag."""
    phi = max(1.0 + fault.gain * (x - 1.0), 1.0 / 16.0)
    return 1.0 / phi + fault.offset_lambda


def _is_none(reading: float) -> bool:
    """Return whether no sensor gives this reading."""
    return not (math.isfinite(reading) and reading > 0.0)


def _aged(fault: Fault, reading: float, last: float, t_s: float) -> float:
    return aged(
        reading,
        last,
        t_s=t_s,
        ripple_lambda=fault.ripple_lambda,
        drift_lambda=fault.drift_lambda,
        hold_s=fault.hold_s,
    )


class TimedSensorFault:
    """A fault on readings at uneven times, such as those of frames on a bus.

    At even times it reads the same as ``SensorFault``. Phi is interpolated linearly between
    readings, so a dead time need not be a whole number of periods.
    """

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._delay_ns = round(fault.delay_s * 1e9)
        self._history: deque[tuple[int, float]] = deque()  # (t_ns, phi), as old as the dead time
        self._x = self._last = math.nan
        self._last_ns = 0
        self._begin_ns: int | None = None

    def push(self, t_ns: int, lambda_healthy: float) -> float:
        """Return the faulty reading in lambda; NaN stays NaN, values of 0 and below stay."""
        reading = self._followed(t_ns, lambda_healthy)
        if _is_none(reading):
            return reading
        if self._begin_ns is None and not _is_none(lambda_healthy):
            self._begin_ns = t_ns
        t_s = (t_ns - (self._begin_ns or t_ns)) / 1e9
        self._last = _aged(self._fault, reading, self._last, t_s)
        return self._last

    def _followed(self, t_ns: int, lambda_healthy: float) -> float:
        fault = self._fault
        at_once = _at_once(fault, lambda_healthy)
        if at_once is not None:
            return at_once
        phi = 1.0 / lambda_healthy
        if self._delay_ns:
            self._history.append((t_ns, phi))
            phi = one_sided(phi, self._delayed(t_ns - self._delay_ns), fault.delay_direction)
        if math.isnan(self._x):
            self._x, self._last_ns = phi, t_ns
        step_s = max(t_ns - self._last_ns, 0) / 1e9
        self._x = lag_step(self._x, phi, fault.tau_rising_s, fault.tau_falling_s, step_s)
        self._last_ns = t_ns
        return _reading(fault, self._x)

    def _delayed(self, t_ns: int) -> float:
        """Return phi at a time; before the first reading, the phi of the first."""
        history = self._history
        while len(history) > 1 and history[1][0] <= t_ns:
            history.popleft()
        (t0_ns, phi) = history[0]
        if len(history) == 1 or t0_ns >= t_ns:
            return phi
        t1_ns, later = history[1]
        return phi + (later - phi) * (t_ns - t0_ns) / (t1_ns - t0_ns)


# Disturbances of the sensor signal. They are random and have no trouble code.
DEFAULT_DISTURBANCE = {"noise": 0.02, "drop_outs": 0.1}
DROP_OUT_S = 0.3  # mean length of a drop-out


class Noise:
    """White noise from reading to reading, with a standard deviation in lambda."""

    def __init__(self, std_lambda: float, seed: str) -> None:
        self._std_lambda, self._random = std_lambda, random.Random(seed)

    def push(self, _: int, lambda_healthy: float) -> float:
        """Return the noisy reading."""
        return lambda_healthy + self._random.gauss(0.0, self._std_lambda)


class DropOuts:
    """A loose contact: the reading is NaN for short random times.

    share : part of the time without a reading, 0 to below 1
    """

    def __init__(self, share: float, seed: str) -> None:
        self._ends_per_s = 1.0 / DROP_OUT_S
        self._begins_per_s = share / ((1.0 - share) * DROP_OUT_S)
        self._random = random.Random(seed)
        self._is_out = False
        self._last_ns: int | None = None

    def push(self, t_ns: int, lambda_healthy: float) -> float:
        """Return the reading, NaN during a drop-out."""
        step_s = max(t_ns - (t_ns if self._last_ns is None else self._last_ns), 0) / 1e9
        self._last_ns = t_ns
        rate = self._ends_per_s if self._is_out else self._begins_per_s
        if self._random.random() < 1.0 - math.exp(-rate * step_s):
            self._is_out = not self._is_out
        return math.nan if self._is_out else lambda_healthy
