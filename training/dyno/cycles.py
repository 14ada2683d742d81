"""Speed traces for the chassis dynamometer: legislated cycles, micro-trips, steady points.

The legislated traces (1 Hz) come from NREL fastsim; see NOTICE.
"""

from importlib import resources
from io import StringIO
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from monitor.base.errors import UsageError
from monitor.base.types import FloatArray

STEP_S = 0.01
LEGISLATED = ("wltc_3b", "udds", "us06", "hwfet")
NAMES = (*LEGISLATED, "micro_trips", "steady")

KM_H = 1.0 / 3.6
TOTAL_RATIO = np.array([13.5, 7.6, 5.05, 3.75, 2.98, 2.45])  # gearbox times final drive
WHEEL_RADIUS_M = 0.31
UPSHIFT_RPM, DOWNSHIFT_RPM = 2350.0, 1250.0
MINIMUM_GEAR_HOLD_S = 2.0


class SpeedTrace(NamedTuple):
    """Speed, gear, brake load and mixture steps of a cycle on a 10 ms grid."""

    speed_m_s: FloatArray  # (n,)
    gear: np.ndarray  # (n,) int64, 0 is neutral
    brake_force_n: FloatArray  # (n,) load of the dynamometer beside the road load
    phi_step: FloatArray  # (n,) step of phi that the test bench adds to the commanded mixture


def load(name: str, rng: np.random.Generator, duration_s: float | None = None) -> SpeedTrace:
    """Return the trace of a cycle.

    rng : draws the driver's shift habit, the micro-trips and the order of the steady points
    duration_s : length of the trace; None is the whole cycle, 1200 s for micro-trips
    Raises UsageError for an unknown cycle or a duration below a step of 10 ms.
    """
    if duration_s is not None and not duration_s >= STEP_S:
        raise UsageError(f"duration {duration_s:g} s: {STEP_S} s or more is wanted")
    if name == "steady":
        trace = _steady_points(rng)
    elif name == "micro_trips":
        trace = _with_gears(_micro_trips(rng, duration_s or 1200.0), rng)
    elif name in LEGISLATED:
        text = resources.files("training.dyno").joinpath(f"cycles/{name}.csv").read_text()
        table = np.loadtxt(StringIO(text), delimiter=",", skiprows=1)
        trace = _with_gears(_resample(table[:, 0], table[:, 1] * KM_H), rng)
    else:
        raise UsageError(f"cycle {name!r} is unknown; there are {', '.join(NAMES)}")
    n = len(trace.speed_m_s) if duration_s is None else round(duration_s / STEP_S)
    return SpeedTrace(*(field[:n] for field in trace))


def _resample(time_s: FloatArray, speed_m_s: FloatArray) -> FloatArray:
    grid = np.arange(round(float(time_s[-1]) / STEP_S)) * STEP_S
    smooth = gaussian_filter1d(np.interp(grid, time_s, speed_m_s), 0.5 / STEP_S)
    return np.asarray(np.maximum(smooth, 0.0))


def _micro_trips(rng: np.random.Generator, duration_s: float) -> FloatArray:
    """Return the speeds of random trips from stop to stop: urban, rural and motorway."""
    time_s, speed = [0.0, 6.0], [0.0, 0.0]
    while time_s[-1] < duration_s + 60.0:
        top = rng.choice([35.0, 50.0, 70.0, 100.0, 130.0], p=[0.25, 0.3, 0.2, 0.15, 0.1]) * KM_H
        _append(time_s, speed, top * rng.uniform(0.8, 1.05), rng.uniform(0.5, 1.6))
        for _ in range(rng.integers(1, 6)):
            time_s.append(time_s[-1] + rng.uniform(4.0, 25.0))
            speed.append(speed[-1])
            _append(time_s, speed, top * rng.uniform(0.45, 1.1), rng.uniform(0.25, 1.2))
        _append(time_s, speed, 0.0, rng.uniform(0.5, 1.5))
        time_s.append(time_s[-1] + rng.uniform(3.0, 20.0))
        speed.append(0.0)
    trace = _resample(np.array(time_s), np.array(speed))
    return trace[: round(duration_s / STEP_S)]


def _append(time_s: list[float], speed: list[float], target: float, slope_m_s2: float) -> None:
    time_s.append(time_s[-1] + max(abs(target - speed[-1]) / slope_m_s2, 0.5))
    speed.append(target)


def _with_gears(speed_m_s: FloatArray, rng: np.random.Generator) -> SpeedTrace:
    """Choose gears by engine speed with hysteresis.

    The driver's habit scales both shift speeds; its standard deviation is 8 %.
    """
    habit = 1.0 + 0.08 * rng.standard_normal()
    every = 10  # gears are chosen at 10 Hz
    gear, hold = 1, 0
    gears = np.empty(len(speed_m_s) // every + 1, dtype=np.int64)
    for i, v in enumerate(speed_m_s[::every]):
        rpm = v / WHEEL_RADIUS_M * TOTAL_RATIO[gear - 1] * 30.0 / np.pi
        hold -= 1
        if hold <= 0 and rpm > UPSHIFT_RPM * habit and gear < len(TOTAL_RATIO):
            gear, hold = gear + 1, round(MINIMUM_GEAR_HOLD_S / (every * STEP_S))
        elif hold <= 0 and rpm < DOWNSHIFT_RPM * habit and gear > 1:
            gear, hold = gear - 1, round(0.5 / (every * STEP_S))
        gears[i] = gear
    full = np.repeat(gears, every)[: len(speed_m_s)]
    full[speed_m_s < 0.3] = 0
    none = np.zeros(len(speed_m_s))
    return SpeedTrace(speed_m_s, full, none, none)


def _steady_points(rng: np.random.Generator) -> SpeedTrace:
    """Hold every point of a grid over engine speed and torque for 25 s, in random order.

    At every point the commanded mixture steps to rich, to lean and back, as on a test bench.
    """
    points = [
        (rpm, torque)
        for rpm in (1100.0, 1500.0, 1900.0, 2400.0, 3000.0, 3600.0)
        for torque in (25.0, 55.0, 90.0, 130.0, 170.0, 210.0)
    ]
    rng.shuffle(points)
    gear = 4
    ratio = TOTAL_RATIO[gear - 1]
    time_s, speed, force = [0.0, 10.0], [0.0, 0.0], [0.0, 0.0]
    steps: list[tuple[float, float]] = []  # time in s, change of the commanded phi from then on
    for rpm, torque in points:
        v = rpm * np.pi / 30.0 / ratio * WHEEL_RADIUS_M
        road_load_n = 130.0 + 1.2 * v + 0.42 * v**2  # rolling resistance plus air drag
        f = torque * ratio * 0.92 / WHEEL_RADIUS_M - road_load_n
        ramp = max(3.0, abs(v - speed[-1]) / 0.8)
        hold_s, size = time_s[-1] + ramp, rng.uniform(0.05, 0.13)
        steps += [(hold_s + 6.0, size), (hold_s + 12.0, -size), (hold_s + 18.0, 0.0)]
        time_s += [time_s[-1] + ramp, time_s[-1] + ramp + 25.0]
        speed += [v, v]
        force += [f, f]
    trace = _resample(np.array(time_s), np.array(speed))
    grid = np.arange(len(trace)) * STEP_S
    brake = np.asarray(gaussian_filter1d(np.interp(grid, time_s, force), 0.5 / STEP_S))
    gears = np.where(trace < 0.3, 0, np.where(trace < 4.0, 1, np.where(trace < 7.0, 2, gear)))
    at = np.searchsorted([when for when, _ in steps], grid, side="right") - 1
    phi_step = np.where(at < 0, 0.0, np.array([size for _, size in steps])[at])
    return SpeedTrace(trace, gears.astype(np.int64), np.where(trace < 7.0, 0.0, brake), phi_step)
