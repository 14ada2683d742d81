"""Sensor faults on streams of lambda readings at uneven times, such as those of frames on a bus."""

import math
import random
from collections import deque

from monitor.base.faults import DROP_OUT_S, Fault, aged, lag_step, one_sided


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


class TimedSensorFault:
    """A fault on readings at uneven times, behind the control loop.

    Phi is interpolated linearly between readings, so a dead time need not be a whole number of
    periods. Communication faults (not_ready, signal_missing) read NaN here.
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
        if not 0.0 < reading < math.inf:  # no sensor gives it
            return reading
        if self._begin_ns is None and 0.0 < lambda_healthy < math.inf:
            self._begin_ns = t_ns
        t_s = 0.0 if self._begin_ns is None else (t_ns - self._begin_ns) / 1e9
        fault = self._fault
        rates = fault.ripple_lambda, fault.drift_lambda, fault.hold_s
        self._last = aged(reading, self._last, t_s, *rates)
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


class NoiseFault:
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
