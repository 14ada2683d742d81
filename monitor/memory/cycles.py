"""Driving cycles in the samples of a vehicle, and the moments at which something counts in them.

A driving cycle is an engine start, the drive and the time until the next engine start. Sources:
13 CCR 1968.2 (c) (driving cycle, engine start, warm-up cycle), (d)(4.3.2) (general denominator)
and (d)(5.5) (ignition cycle); UN R83 annex 11. Time comes with the samples.
"""

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

from monitor.base.config import CyclesConfig, ProfileConfig
from monitor.base.types import Quality, SampleBlock

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
    """The counts of a block; sample numbers never fall."""

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
        columns = (
            [absent] * n if place is None else block.values[:, place].tolist()
            for place, absent in zip(self._places, _ABSENT.values(), strict=True)
        )
        heard = block.quality[:, self._heard].tolist()
        samples = zip(block.t_ns.tolist(), heard, *columns, strict=True)
        for k, (t_ns, quality, speed_rpm, *others) in enumerate(samples):
            step_ns = 0 if self._last_ns is None else max(t_ns - self._last_ns, 0)
            self._last_ns = t_ns
            runs = speed_rpm >= self._running_rpm
            if not self._has_speed:
                runs = quality != _SILENT and quality not in _UNKNOWN
            if runs:
                self._run(k, step_ns, others, found)
                continue
            self._idle_ns = 0
            if quality not in _UNKNOWN:
                is_standing = not math.isnan(speed_rpm)
                self._stand(step_ns, is_silent=quality == _SILENT, is_standing=is_standing)
        return found

    def _stand(self, step_ns: int, *, is_silent: bool, is_standing: bool) -> None:
        """Take a sample in which the engine does not run."""
        self._stopped_ns += step_ns
        self._silence_ns = self._silence_ns + step_ns if is_silent else 0
        self._was_asleep |= self._silence_ns >= 1e9 * self._config.silent_s
        self._stood |= self._was_asleep and is_standing

    def _run(self, k: int, step_ns: int, signals: Sequence[float], found: Counting) -> None:
        """Take a sample in which the engine runs; ``signals`` are those behind the engine speed.

        The very first start belongs to the driving cycle that has begun already.
        """
        speed_km_h, coolant_degc, ambient_degc, pressure_kpa = signals
        starts = not self._has_run or self._stopped_ns > 0
        if starts:
            is_long = self._stopped_ns >= 1e9 * self._config.engine_off_s
            if self._has_run and (self._stood or is_long):
                self._begin()
                found.moments.append((k, "driving_cycle"))
            self._has_run = True
            self._stop()
            step_ns = self._start_ns = self._idle_ns = 0  # the time since the last is not driven
        self._start_ns += step_ns
        due = self._due
        if "ignition_cycle" in due and self._start_ns >= 1e9 * self._config.start_s:
            self._count("ignition_cycle", k, found)
        if "warm_up" in due and self._is_warm(coolant_degc):
            self._count("warm_up", k, found)
        if "general_denominator" in due and not starts:
            fits = (
                ambient_degc >= self._config.denominator_ambient_min_degc
                and pressure_kpa >= self._config.denominator_pressure_min_kpa
            )
            if self._is_general(step_ns, speed_km_h, fits=fits):
                self._count("general_denominator", k, found)
        self._drive(k, step_ns, speed_km_h, found)

    def _count(self, moment: Moment, k: int, found: Counting) -> None:
        self._due.remove(moment)
        found.moments.append((k, moment))

    def _is_warm(self, coolant_degc: float) -> bool:
        """Return whether the coolant is warm and has risen enough since the engine's start."""
        if math.isnan(self._first_degc):
            self._first_degc = coolant_degc
        rise_degc, profile = coolant_degc - self._first_degc, self._profile
        return coolant_degc >= profile.warm_up_degc and rise_degc >= profile.warm_up_rise_degc

    def _is_general(self, step_ns: int, speed_km_h: float, *, fits: bool) -> bool:
        """Return whether the drive was long enough, fast enough and idle once.

        fits : neither too cold nor too high
        """
        config = self._config
        is_idle = fits and speed_km_h <= config.denominator_idle_km_h
        self._idle_ns = self._idle_ns + step_ns if is_idle else 0
        self._has_idled |= self._idle_ns >= 1e9 * config.denominator_idle_s
        if not fits:
            return False
        self._fit_ns += step_ns
        self._moving_ns += step_ns * (speed_km_h >= config.denominator_moving_km_h)
        return (
            self._has_idled
            and self._fit_ns >= 1e9 * config.denominator_run_s
            and self._moving_ns >= 1e9 * config.denominator_moving_s
        )

    def _drive(self, k: int, step_ns: int, speed_km_h: float, found: Counting) -> None:
        """Count running time and distance whenever a whole second has passed."""
        second = self._run_ns // _SECOND_NS
        self._run_ns += step_ns
        if speed_km_h > 0.0:
            self._run_km += speed_km_h * step_ns * _HOURS_PER_NS
        if self._run_ns // _SECOND_NS > second:
            run_s = (self._run_ns - self._told_ns) * 1e-9
            found.driven.append((k, Driven(run_s, self._run_km - self._told_km)))
            self._told_ns, self._told_km = self._run_ns, self._run_km
