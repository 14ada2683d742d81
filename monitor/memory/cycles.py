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
from monitor.memory.denominator import Denominator, first_of, whole_ns
from monitor.memory.engine_watch import EngineWatch

SIGNALS: Final = (
    "engine_speed_rpm",
    "vehicle_speed_km_h",
    "coolant_temperature_degc",
    "ambient_temperature_degc",
    "ambient_pressure_kpa",
)
Moment = Literal["driving_cycle", "ignition_cycle", "warm_up", "general_denominator"]
# in this order at one sample; those behind the first are counted once in each driving cycle
_ORDER: Final[tuple[Moment, ...]] = (
    "driving_cycle",
    "ignition_cycle",
    "warm_up",
    "general_denominator",
)
_SECOND_NS: Final = 1_000_000_000  # driving is counted in steps of so much
_HOURS_PER_NS: Final = 1.0 / 3.6e12
_UNKNOWN: Final = (Quality.OFF_BUS, Quality.GAP)  # of an engine not heard nothing is known
_RUNS: Final = -1  # code of samples in which the engine runs


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
        self._at = {name: i for i, name in enumerate(names)}
        self._config, self._profile, self._running_rpm = config, profile, running_rpm
        self._heard = self._at.get(SIGNALS[0], self._at[output])
        self.unavailable = tuple(name for name in SIGNALS if name not in self._at)
        self._engine = EngineWatch(config)
        self._start_least_ns = whole_ns(config.start_s)
        self._last_ns: int | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin a driving cycle."""
        self._start_ns = 0  # since the engine's last start
        self._denominator = Denominator(self._config)
        self._due: set[Moment] = {*_ORDER[1:]}
        self._first_degc = math.nan  # coolant at the engine's start
        self._run_ns, self._run_km = 0, 0.0  # in the driving cycle
        self._taken_ns, self._taken_km = 0, 0.0  # of these, given out in ``Driven``

    def push(self, block: SampleBlock) -> Counting:
        """Return the counts due on samples, at each a new driving cycle first."""
        n = len(block.t_ns)
        found = Counting([], [])
        if n == 0:
            return found
        first_ns = block.t_ns[0] if self._last_ns is None else self._last_ns
        self._last_ns = block.t_ns.item(n - 1)
        steps_ns = np.maximum(np.diff(block.t_ns, prepend=first_ns), 0)
        signals = [
            block.values[:, self._at[name]] if name in self._at else None for name in SIGNALS
        ]
        heard = block.quality[:, self._heard].astype(np.int64)
        codes = self._codes(heard, signals[0])
        for begin, end, code in alike(codes):
            inside = slice(begin, end)
            if code == _RUNS:
                own = [each if each is None else each[inside] for each in signals[1:]]
                self._run(begin, steps_ns[inside].copy(), own, found)
                continue
            self._denominator.interrupt()
            quality, is_standing = divmod(code, 2)
            if quality not in _UNKNOWN:
                self._engine.stand(
                    int(steps_ns[inside].sum()),
                    is_silent=quality == Quality.STALE,
                    is_standing=bool(is_standing),
                )
        return found

    def _codes(self, heard: IntArray, speed_rpm: FloatArray | None) -> IntArray:
        """Return a number for each sample, (n,): whether the engine runs, else how it is heard.

        heard : (n,) quality of the speed, or of the output where there is no speed
        """
        if speed_rpm is None:
            return np.where(np.isin(heard, (Quality.STALE, *_UNKNOWN)), 2 * heard, _RUNS)
        stands = 2 * heard + ~np.isnan(speed_rpm)
        return np.where(speed_rpm >= self._running_rpm, _RUNS, stands)

    def _run(
        self,
        begin: int,
        steps_ns: IntArray,
        signals: Sequence[FloatArray | None],
        found: Counting,
    ) -> None:
        """Take samples from ``begin`` on in which the engine runs.

        steps_ns : (n,) time since the sample before
        signals : (n,) each of those behind the engine speed, None where it is not provided
        """
        speed_km_h, coolant_degc, ambient_degc, pressure_kpa = signals
        started, is_next = self._engine.run()
        if is_next:
            self._begin()
            found.moments.append((begin, "driving_cycle"))
        if started:  # the time since the last sample is not driven
            self._start_ns, steps_ns[0] = 0, 0
            self._denominator.interrupt()
        since_ns = self._start_ns + np.cumsum(steps_ns)
        self._start_ns = int(since_ns[-1])
        reached: dict[Moment, int | None] = {}
        if "ignition_cycle" in self._due:
            reached["ignition_cycle"] = first_of(since_ns >= self._start_least_ns)
        if "warm_up" in self._due and coolant_degc is not None:
            reached["warm_up"] = first_of(self._is_warm(coolant_degc))
        first = int(started)
        if "general_denominator" in self._due and first < len(steps_ns):
            fits = self._fits(len(steps_ns), ambient_degc, pressure_kpa)
            at = self._denominator.push(
                steps_ns[first:], fits[first:], None if speed_km_h is None else speed_km_h[first:]
            )
            reached["general_denominator"] = None if at is None else first + at
        at_once = [(begin + k, moment) for moment, k in reached.items() if k is not None]
        self._due -= {moment for _, moment in at_once}
        found.moments.extend(sorted(at_once, key=lambda each: (each[0], _ORDER.index(each[1]))))
        self._drive(begin, steps_ns, speed_km_h, found)

    def _is_warm(self, coolant_degc: FloatArray) -> BoolArray:
        """Return where the coolant is warm and has risen enough since the engine's start."""
        if math.isnan(self._first_degc):
            known = coolant_degc[~np.isnan(coolant_degc)]
            self._first_degc = known.item(0) if known.size else math.nan
        rise_degc, profile = coolant_degc - self._first_degc, self._profile
        is_warm = coolant_degc >= profile.warm_up_degc
        return np.asarray(is_warm & (rise_degc >= profile.warm_up_rise_degc))

    def _fits(
        self, n: int, ambient_degc: FloatArray | None, pressure_kpa: FloatArray | None
    ) -> BoolArray:
        """Return where it is neither too cold nor too high for the general denominator, (n,)."""
        fits = np.ones(n, dtype=np.bool_)
        if ambient_degc is not None:
            fits &= ambient_degc >= self._config.denominator_ambient_min_degc
        if pressure_kpa is not None:
            fits &= pressure_kpa >= self._config.denominator_pressure_min_kpa
        return fits

    def _drive(
        self, begin: int, steps_ns: IntArray, speed_km_h: FloatArray | None, found: Counting
    ) -> None:
        """Count running time and distance whenever a whole second has passed."""
        run_ns = self._run_ns + np.cumsum(steps_ns)
        run_km = np.full(len(steps_ns), self._run_km)
        if speed_km_h is not None:
            moved_km = np.fmax(speed_km_h, 0.0) * steps_ns * _HOURS_PER_NS
            moved_km[0] += self._run_km
            np.add.accumulate(moved_km, out=run_km)
        seconds = np.concatenate([[self._run_ns], run_ns]) // _SECOND_NS
        for k in np.flatnonzero(np.diff(seconds)).tolist():
            now_ns, now_km = run_ns.item(k), run_km.item(k)
            driven = Driven((now_ns - self._taken_ns) * 1e-9, now_km - self._taken_km)
            found.driven.append((begin + k, driven))
            self._taken_ns, self._taken_km = now_ns, now_km
        self._run_ns, self._run_km = run_ns.item(-1), run_km.item(-1)
