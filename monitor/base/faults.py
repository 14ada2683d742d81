"""Sensor faults as pure transforms of phi = 1/lambda, sample by sample.

Rising phi is lean to rich. The healthy sensor reads u, the faulty one s:

- lag: dx/dt = (u - x) / tau with the tau of the direction of u - x;
- dead time d on rising edges s(t) = min(u(t), u(t - d)), on falling edges max(u(t), u(t - d)),
  on both u(t - d);
- gain: s = 1 + g (u - 1);
- offset: in lambda.

The scalar steps are plain functions, so that the simulated dynamometer can compile the same code
into its control loop; ``SensorFault`` applies them to a stream.
"""

import math
import random
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

from monitor.base.errors import UsageError

RICH_TO_LEAN, LEAN_TO_RICH, SYMMETRIC = -1, 1, 0

TRANSIENT_GAIN = 0.7  # amplitude left by the transient-time fault, whose severity is its lag
OUT_OF_RANGE_LAMBDA = 0.31  # below what any wideband sensor can read


def lag_step(x: float, u: float, tau_rising_s: float, tau_falling_s: float, step_s: float) -> float:
    """Return the lagged value one step later, exact for a constant ``u``."""
    tau_s = tau_rising_s if u > x else tau_falling_s
    if tau_s <= 0.0:
        return u
    return x + (u - x) * (1.0 - math.exp(-step_s / tau_s))


def one_sided(u: float, delayed: float, direction: int) -> float:
    """Return what a sensor reads whose dead time acts on one edge direction, or on both."""
    if direction > 0:
        return min(u, delayed)
    if direction < 0:
        return max(u, delayed)
    return delayed


@dataclass(frozen=True, slots=True)
class Fault:
    """A named fault, resolved to what it does."""

    name: str
    severity: float
    tau_rising_s: float = 0.0
    tau_falling_s: float = 0.0
    delay_s: float = 0.0
    delay_direction: int = SYMMETRIC
    gain: float = 1.0
    offset_lambda: float = 0.0
    stuck_lambda: float = 0.0  # 0 is not stuck
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
}
NAMES = tuple(DEFAULT_SEVERITY)


def resolve(name: str, severity: float | None = None) -> Fault:
    """Return the fault of that name; a missing severity takes the name's usual one.

    severity : time constant or dead time in s, gain, or offset in lambda; for out_of_range the
        lambda that is sent; stuck_lean and stuck_rich freeze that far from lambda 1
    Raises UsageError for an unknown name or an impossible severity.
    """
    if name not in DEFAULT_SEVERITY:
        raise UsageError(f"fault {name!r} is unknown; there are {', '.join(NAMES)}")
    s = DEFAULT_SEVERITY[name] if severity is None else float(severity)
    if not math.isfinite(s) or s <= 0.0:
        raise UsageError(f"fault {name}: severity {s} is not positive")
    if name == "gain_low" and s >= 1.0:
        raise UsageError(f"fault gain_low: severity {s} is the gain that is left, wanted below 1")
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
        "not_ready": Fault(name, s, not_ready=True),
        "out_of_range": Fault(name, s, stuck_lambda=s),
        "signal_missing": Fault(name, s, missing=True),
    }[name]


def combine(parts: Sequence[Fault]) -> Fault | None:
    """Return one fault that does what all parts do, None for no part.

    Raises UsageError if two parts set the same thing.
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
    """A fault put onto a stream of lambda readings, after the control loop.

    Not for faults of the communication (not_ready, signal_missing): these read NaN here.
    """

    def __init__(self, fault: Fault, period_s: float) -> None:
        self._fault = fault
        self._period_s = period_s
        self._history: deque[float] = deque(maxlen=round(fault.delay_s / period_s) + 1)
        self._x = math.nan

    def push(self, lambda_healthy: float) -> float:
        """Return what the faulty sensor reads; NaN stays NaN, and what no sensor can read stays."""
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
    """Return what is read whatever came before, None if dead time and lag have a say."""
    if not math.isfinite(lambda_healthy) or fault.not_ready or fault.missing:
        return math.nan
    if fault.stuck_lambda:
        return fault.stuck_lambda
    return lambda_healthy if lambda_healthy <= 0.0 else None


def _reading(fault: Fault, x: float) -> float:
    """Return the lambda that is read of ``x``, phi behind dead time and lag."""
    phi = max(1.0 + fault.gain * (x - 1.0), 1.0 / 16.0)
    return 1.0 / phi + fault.offset_lambda


class TimedSensorFault:
    """A fault put onto readings that come at their own times, as frames on a bus do.

    At even times it reads exactly what ``SensorFault`` reads. Between readings phi is a straight
    line, so that a dead time need not be a whole number of periods.
    """

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._delay_ns = round(fault.delay_s * 1e9)
        self._history: deque[tuple[int, float]] = deque()  # (t_ns, phi), back to the dead time
        self._x = math.nan
        self._last_ns = 0

    def push(self, t_ns: int, lambda_healthy: float) -> float:
        """Return what the faulty sensor reads; NaN stays NaN, and what no sensor can read stays."""
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
        """Return phi as it was then; before the first reading, that of the first."""
        history = self._history
        while len(history) > 1 and history[1][0] <= t_ns:
            history.popleft()
        (t0_ns, phi) = history[0]
        if len(history) == 1 or t0_ns >= t_ns:
            return phi
        t1_ns, later = history[1]
        return phi + (later - phi) * (t_ns - t0_ns) / (t1_ns - t0_ns)


# Disturbances of the sensor's line. They have no code of their own and are random.
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
    """A loose contact: at random instants there is no reading for a while, NaN.

    share : of the time without a reading, below 1
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
