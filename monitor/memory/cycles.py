"""Driving cycles in the samples of a vehicle, and the moments at which something counts in them.

A driving cycle is an engine start, the drive and the time until the next engine start. Sources:
13 CCR 1968.2 (c) (driving cycle, engine start, warm-up cycle), (d)(4.3.2) (general denominator)
and (d)(5.5) (ignition cycle); UN R83 annex 11. Time comes with the samples.
"""

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np

from monitor.base.config import CyclesConfig, ProfileConfig
from monitor.base.runs import alike
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, SampleBlock

# each with the value that stands for it where it is not provided: nothing is then known of speed
# and coolant, and the air is neither too cold nor too thin
_ABSENT: Final = {
    "engine_speed_rpm": math.nan,
    "vehicle_speed_km_h": math.nan,
    "coolant_temperature_degc": math.nan,
    "ambient_temperature_degc": math.inf,
    "ambient_pressure_kpa": math.inf,
}
SIGNALS: Final = tuple(_ABSENT)
Moment = Literal["driving_cycle", "ignition_cycle", "warm_up", "general_denominator"]
_SECOND_NS: Final = 1_000_000_000  # driving is counted in steps of so much
_HOURS_PER_NS: Final = 1.0 / 3.6e12
# of an engine not heard nothing is known
_UNKNOWN: Final = (int(Quality.OFF_BUS), int(Quality.GAP))
_SILENT: Final = int(Quality.STALE)


class Driven(NamedTuple):
    """Time that the engine ran, and distance, since the last of these."""

    engine_run_s: float
    distance_km: float


class Counting(NamedTuple):
    """The counts of a block, each with the number of its sample."""

    moments: list[tuple[int, Moment]]
    driven: list[tuple[int, Driven]]


class Cycles:
    """Finds the moments at which something is to be counted.

    names : signals of a sample
    output : name of the measured signal among them; where no engine speed is provided the engine
        runs while it is heard
    running_rpm : engine speed from which the engine runs
    """

    def __init__(
        self,
        config: CyclesConfig,
        profile: ProfileConfig,
        names: Sequence[str],
        output: str,
        running_rpm: float,
    ) -> None:
        at = {name: i for i, name in enumerate(names)}
        self._places = [at.get(name) for name in SIGNALS]
        self._heard, self._has_speed = at.get(SIGNALS[0], at[output]), SIGNALS[0] in at
        self._config, self._profile, self._running_rpm = config, profile, running_rpm
        self._last_ns: int | None = None
        self._has_run = False  # since the first sample
        self._stop()
        self._begin()

    def _stop(self) -> None:
        """Forget how the engine stood before it runs."""
        self._stopped_ns = 0  # since it was last seen running
        self._silence_ns = 0  # of the ECU, at present
        self._was_asleep = False  # the ECU was silent for long since then
        self._stood = False  # and was heard again with the engine standing

    def _begin(self) -> None:
        """Begin a driving cycle."""
        self._start_ns = 0  # since the engine's last start
        self._due: set[Moment] = {"ignition_cycle", "warm_up", "general_denominator"}
        self._first_degc = math.nan  # coolant at the engine's start
        self._fit_ns = self._moving_ns = self._idle_ns = 0  # for the general denominator
        self._has_idled = False
        self._run_ns, self._run_km = 0, 0.0  # in the driving cycle
        self._told_ns, self._told_km = 0, 0.0  # of these, given out in ``Driven``

    def push(self, block: SampleBlock) -> Counting:
        """Return the counts due on samples, at each a new driving cycle first."""
        found, n = Counting([], []), len(block.t_ns)
        if not n:
            return found
        speed_rpm, *signals = (
            np.full(n, absent) if place is None else block.values[:, place]
            for place, absent in zip(self._places, _ABSENT.values(), strict=True)
        )
        quality = block.quality[:, self._heard]
        is_silent, known = quality == _SILENT, ~np.isin(quality, _UNKNOWN)
        runs = speed_rpm >= self._running_rpm if self._has_speed else known & ~is_silent
        before_ns = block.t_ns[0] if self._last_ns is None else self._last_ns
        steps_ns = np.maximum(np.diff(block.t_ns, prepend=before_ns), 0)
        self._last_ns = int(block.t_ns[-1])
        for begin, end, engine_runs in alike(runs):
            part = slice(begin, end)
            if engine_runs:
                self._run(begin, steps_ns[part], [signal[part] for signal in signals], found)
                continue
            self._idle_ns = 0
            for k in begin + np.flatnonzero(known[part]):
                is_standing = not math.isnan(speed_rpm[k])
                self._stand(int(steps_ns[k]), is_silent=is_silent[k], is_standing=is_standing)
        return found

    def _stand(self, step_ns: int, *, is_silent: bool, is_standing: bool) -> None:
        """Take a sample in which the engine does not run."""
        self._stopped_ns += step_ns
        self._silence_ns = self._silence_ns + step_ns if is_silent else 0
        self._was_asleep |= self._silence_ns >= 1e9 * self._config.silent_s
        self._stood |= self._was_asleep and is_standing

    def _run(
        self, first: int, steps_ns: IntArray, signals: Sequence[FloatArray], found: Counting
    ) -> None:
        """Take samples in which the engine runs; ``signals`` are those behind the engine speed.

        The very first start belongs to the driving cycle that has begun already.
        """
        speed_km_h, coolant_degc, ambient_degc, pressure_kpa = signals
        config = self._config
        if not self._has_run or self._stopped_ns > 0:
            is_long = self._stopped_ns >= 1e9 * config.engine_off_s
            if self._has_run and (self._stood or is_long):
                self._begin()
                found.moments.append((first, "driving_cycle"))
            self._has_run = True
            self._stop()
            self._start_ns = self._idle_ns = 0
            steps_ns = steps_ns.copy()
            steps_ns[0] = 0  # the time since the last is not driven
        run_ns = self._start_ns + np.cumsum(steps_ns)
        self._start_ns = int(run_ns[-1])
        reached: dict[Moment, BoolArray] = {"ignition_cycle": run_ns >= 1e9 * config.start_s}
        if "warm_up" in self._due:
            reached["warm_up"] = self._is_warm(coolant_degc)
        if "general_denominator" in self._due:
            fits = ambient_degc >= config.denominator_ambient_min_degc
            fits &= pressure_kpa >= config.denominator_pressure_min_kpa
            reached["general_denominator"] = self._is_general(steps_ns, speed_km_h, fits)
        for moment, is_reached in reached.items():
            if moment in self._due and is_reached.any():
                self._due.remove(moment)
                found.moments.append((first + int(is_reached.argmax()), moment))
        self._drive(first, steps_ns, speed_km_h, found)

    def _is_warm(self, coolant_degc: FloatArray) -> BoolArray:
        """Return where the coolant is warm and has risen enough since the engine's start."""
        if math.isnan(self._first_degc):
            known = coolant_degc[~np.isnan(coolant_degc)]
            self._first_degc = float(known[0]) if len(known) else math.nan
        rise_degc, profile = coolant_degc - self._first_degc, self._profile
        is_risen = rise_degc >= profile.warm_up_rise_degc
        return np.asarray(is_risen & (coolant_degc >= profile.warm_up_degc))

    def _is_general(self, steps_ns: IntArray, speed_km_h: FloatArray, fits: BoolArray) -> BoolArray:
        """Return where the drive has been long enough, fast enough and idle once.

        fits : neither too cold nor too high
        """
        config = self._config
        is_idle = fits & (speed_km_h <= config.denominator_idle_km_h)
        idle_ns = self._idle_ns + np.cumsum(steps_ns * is_idle)
        idle_ns -= np.maximum.accumulate(np.where(is_idle, 0, idle_ns))  # of the latest one
        self._idle_ns = int(idle_ns[-1])
        idled = np.maximum.accumulate(idle_ns) >= 1e9 * config.denominator_idle_s
        idled |= self._has_idled
        self._has_idled = bool(idled[-1])
        is_moving = fits & (speed_km_h >= config.denominator_moving_km_h)
        fit_ns = self._fit_ns + np.cumsum(steps_ns * fits)
        moving_ns = self._moving_ns + np.cumsum(steps_ns * is_moving)
        self._fit_ns, self._moving_ns = int(fit_ns[-1]), int(moving_ns[-1])
        is_long = fit_ns >= 1e9 * config.denominator_run_s
        is_long &= moving_ns >= 1e9 * config.denominator_moving_s
        return np.asarray(fits & idled & is_long)

    def _drive(
        self, first: int, steps_ns: IntArray, speed_km_h: FloatArray, found: Counting
    ) -> None:
        """Count running time and distance whenever a whole second has passed."""
        run_ns = np.cumsum(np.concatenate([[self._run_ns], steps_ns]))
        driven_km = np.where(speed_km_h > 0.0, speed_km_h * steps_ns * _HOURS_PER_NS, 0.0)
        run_km = np.cumsum(np.concatenate([[self._run_km], driven_km]))
        self._run_ns, self._run_km = int(run_ns[-1]), float(run_km[-1])
        at = np.flatnonzero(np.diff(run_ns // _SECOND_NS))
        driven = at.tolist(), run_ns[at + 1].tolist(), run_km[at + 1].tolist()
        for k, now_ns, now_km in zip(*driven, strict=True):
            run_s = (now_ns - self._told_ns) * 1e-9
            found.driven.append((first + k, Driven(run_s, now_km - self._told_km)))
            self._told_ns, self._told_km = now_ns, now_km
