"""Driving cycles in one stream of samples, and what counts in them.

A driving cycle is an engine start, the drive and the time until the next engine start. Sources:
13 CCR 1968.2 (c) (driving cycle, engine start, warm-up cycle), (d)(4.3.2) (general denominator)
and (d)(5.5) (ignition cycle); UN R83 annex 11. Time comes with the samples.
"""

import math
from collections.abc import Sequence
from typing import Final, Literal

from monitor.base.config import CyclesConfig, ProfileConfig
from monitor.base.types import Quality, Sample

SIGNALS: Final = (
    "engine_speed_rpm",
    "vehicle_speed_km_h",
    "coolant_temperature_degc",
    "ambient_temperature_degc",
    "ambient_pressure_kpa",
)
Moment = Literal["driving_cycle", "ignition_cycle", "warm_up", "general_denominator"]
_NONE: Final[tuple[Moment, ...]] = ()


class EngineWatch:
    """Tells engine starts within a driving cycle from those that begin the next one."""

    def __init__(self, config: CyclesConfig) -> None:
        self._config = config
        self._has_run = False  # since the first sample
        self._restart()

    def _restart(self) -> None:
        self._off_s = 0.0  # since the engine was last seen running
        self._silence_s = 0.0  # of the ECU, at present
        self._was_asleep = False  # the ECU was silent for long since then
        self._stood = False  # and was heard again with the engine standing

    def stand(self, elapsed_s: float, *, is_silent: bool, is_standing: bool) -> None:
        """Take a sample in which the engine does not run."""
        self._off_s += elapsed_s
        self._silence_s = self._silence_s + elapsed_s if is_silent else 0.0
        self._was_asleep |= self._silence_s >= self._config.silent_s
        self._stood |= self._was_asleep and is_standing

    def run(self) -> tuple[bool, bool]:
        """Take a sample in which it runs; return whether it started, and to a new cycle.

        The very first start belongs to the driving cycle that has begun already.
        """
        if self._has_run and self._off_s == 0.0:
            return False, False
        is_next = self._has_run and (self._stood or self._off_s >= self._config.engine_off_s)
        self._has_run = True
        self._restart()
        return True, is_next


class Cycles:
    """Finds the moments at which something is to be counted.

    names : what a sample holds
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
        self._config, self._profile, self._running_rpm = config, profile, running_rpm
        # a signal that is not there is the NaN behind a sample's values
        self._speed, self._vehicle, self._coolant, self._ambient, self._pressure = (
            at.get(name, -1) for name in SIGNALS
        )
        self._heard = at[output] if self._speed < 0 else self._speed
        self.unavailable = tuple(name for name in SIGNALS if name not in at)
        self._engine = EngineWatch(config)
        self._last_ns: int | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin a driving cycle."""
        self._start_s = 0.0  # since the engine's last start
        self._run_s = self._moving_s = self._idle_s = 0.0  # as the general denominator has them
        self._has_idled = False
        self._due: set[Moment] = {"ignition_cycle", "warm_up", "general_denominator"}
        self._first_degc = math.nan  # coolant at the engine's start
        self.engine_run_s = self.distance_km = 0.0  # not taken yet

    def take(self) -> tuple[float, float]:
        """Return engine running time in s and distance in km since they were last taken."""
        taken = self.engine_run_s, self.distance_km
        self.engine_run_s = self.distance_km = 0.0
        return taken

    def push(self, sample: Sample) -> Sequence[Moment]:
        """Take one sample; return what is to be counted, a new driving cycle first."""
        last_ns, self._last_ns = self._last_ns, sample.t_ns
        elapsed_s = 0.0 if last_ns is None else max(sample.t_ns - last_ns, 0) * 1e-9
        values = sample.values.tolist()
        values.append(math.nan)
        is_running, is_standing = self._is_running(sample, values)
        if not is_running:
            quality = sample.quality.item(self._heard)
            if quality != Quality.OFF_BUS:  # else nothing is known of the engine
                is_silent = quality == Quality.STALE
                self._engine.stand(elapsed_s, is_silent=is_silent, is_standing=is_standing)
            self._idle_s = 0.0
            return _NONE
        started, is_next = self._engine.run()
        found: list[Moment] = []
        if is_next:
            self._begin()
            found.append("driving_cycle")
        if started:
            self._start_s = self._idle_s = 0.0
        else:
            self._drive(elapsed_s, values)
        if self._due:
            self._count(values[self._coolant], found)
        return found

    def _is_running(self, sample: Sample, values: list[float]) -> tuple[bool, bool]:
        """Return whether the engine runs, and whether it is known to stand."""
        if self._speed < 0:
            is_heard = sample.quality.item(self._heard) not in (Quality.STALE, Quality.OFF_BUS)
            return is_heard, False
        speed_rpm = values[self._speed]
        return speed_rpm >= self._running_rpm, speed_rpm < self._running_rpm

    def _drive(self, elapsed_s: float, values: list[float]) -> None:
        """Take the time since the last sample, in which the engine ran, too."""
        config = self._config
        self._start_s += elapsed_s
        self.engine_run_s += elapsed_s
        speed_km_h = values[self._vehicle]
        if speed_km_h > 0.0:
            self.distance_km += speed_km_h * elapsed_s / 3600.0
        if "general_denominator" not in self._due:
            return
        too_cold = self._ambient >= 0 and not (
            values[self._ambient] >= config.denominator_ambient_min_degc
        )
        too_high = self._pressure >= 0 and not (
            values[self._pressure] >= config.denominator_pressure_min_kpa
        )
        if too_cold or too_high:
            self._idle_s = 0.0
            return
        self._run_s += elapsed_s
        if speed_km_h >= config.denominator_moving_km_h:
            self._moving_s += elapsed_s
        idles = speed_km_h <= config.denominator_idle_km_h
        self._idle_s = self._idle_s + elapsed_s if idles else 0.0
        self._has_idled |= self._idle_s >= config.denominator_idle_s

    def _count(self, coolant_degc: float, found: list[Moment]) -> None:
        """Find what is due and reached."""
        config, profile, due = self._config, self._profile, self._due
        if math.isnan(self._first_degc):
            self._first_degc = coolant_degc
        if "ignition_cycle" in due and self._start_s >= config.start_s:
            found.append("ignition_cycle")
        if (
            "warm_up" in due
            and coolant_degc >= profile.warm_up_degc
            and coolant_degc - self._first_degc >= profile.warm_up_rise_degc
        ):
            found.append("warm_up")
        if (
            "general_denominator" in due
            and self._has_idled
            and self._run_s >= config.denominator_run_s
            and self._moving_s >= config.denominator_moving_s
        ):
            found.append("general_denominator")
        due.difference_update(found)
