"""Driving cycles in the samples of a vehicle, and the moments at which something counts in them.

A driving cycle is an engine start, the drive and the time until the next engine start. Sources:
13 CCR 1968.2 (c) (driving cycle, engine start, warm-up cycle), (d)(4.3.2) (general denominator)
and (d)(5.5) (ignition cycle); UN R83 annex 11. Time comes with the samples.
"""

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.config import CyclesConfig, ProfileConfig
from monitor.base.runs import Thresholds, alike
from monitor.base.types import FloatArray, IntArray, Quality, SampleBlock
from monitor.memory.denominator import Denominator, DrivenSpan, Flags, whole_ns
from monitor.memory.engine_watch import EngineWatch

SIGNALS: Final = (
    "engine_speed_rpm",
    "vehicle_speed_km_h",
    "coolant_temperature_degc",
    "ambient_temperature_degc",
    "ambient_pressure_kpa",
)
Moment = Literal["driving_cycle", "ignition_cycle", "warm_up", "general_denominator"]
_ORDER: Final[tuple[Moment, ...]] = (
    "driving_cycle",
    "ignition_cycle",
    "warm_up",
    "general_denominator",
)
_DUE: Final = frozenset(_ORDER[1:])  # counted once in each driving cycle
_SECOND_NS: Final = 1_000_000_000  # driving is counted in steps of so much
_HOURS_PER_NS: Final = 1.0 / 3.6e12
_N_QUALITIES: Final = len(Quality)
_UNKNOWN: Final = (Quality.OFF_BUS, Quality.GAP)  # of an engine not heard nothing is known
# bits of a sample, in the order of the thresholds in ``Cycles``
_RUNS, _MOVES, _WARM, _MILD, _LOW, _ENGINE_KNOWN, _SPEED_KNOWN, _ROLLS = (1 << b for b in range(8))


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
        self._config, self._profile, self._running_rpm = config, profile, running_rpm
        self._speed, self._vehicle, self._coolant, self._ambient, self._pressure = map(
            at.get, SIGNALS
        )
        self._heard = at[output] if self._speed is None else self._speed
        least = (
            running_rpm,
            config.denominator_moving_km_h,
            profile.warm_up_degc,
            config.denominator_ambient_min_degc,
            config.denominator_pressure_min_kpa,
        )
        rolls_km_h = math.nextafter(config.denominator_idle_km_h, math.inf)
        places = [at.get(name, 0) for name in (*SIGNALS, *SIGNALS[:2], SIGNALS[1])]
        self._thresholds = Thresholds(places, [*least, -math.inf, -math.inf, rolls_km_h])
        self.unavailable = tuple(name for name in SIGNALS if name not in at)
        self._engine = EngineWatch(config)
        self._start_least_ns = whole_ns(config.start_s)
        self._last_ns: int | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin a driving cycle."""
        self._start_ns = 0  # since the engine's last start
        self._denominator = Denominator(self._config)
        self._due: frozenset[Moment] = _DUE
        self._first_degc = math.nan  # coolant at the engine's start
        self._run_ns, self._run_km = 0, 0.0  # in the driving cycle
        self._taken_ns, self._taken_km = 0, 0.0  # of these, given out in ``Driven``

    def push(self, block: SampleBlock) -> Counting:
        """Return the counts due on samples, at each a new driving cycle first."""
        n = len(block.t_ns)
        found = Counting([], [])
        if n == 0:
            return found
        until_ns = np.zeros(n + 1, dtype=np.int64)  # [k + 1]: time until sample k
        if self._last_ns is not None:
            until_ns[1] = max(block.t_ns.item(0) - self._last_ns, 0)
        if n > 1:
            np.maximum(block.t_ns[1:] - block.t_ns[:-1], 0, out=until_ns[2:])
            np.cumsum(until_ns, out=until_ns)
        self._last_ns = block.t_ns.item(n - 1)
        values = block.values
        coolant_degc = None if self._coolant is None else values[:, self._coolant]
        speed_km_h = None if self._vehicle is None else values[:, self._vehicle]
        for begin, end, code in alike(self._codes(block)):
            bits, heard = divmod(code, _N_QUALITIES)
            runs, stands = bits & _RUNS, bits & _ENGINE_KNOWN
            if self._speed is None:
                runs, stands = heard not in (Quality.STALE, *_UNKNOWN), 0
            if runs:
                span = DrivenSpan(begin, end, until_ns)
                self._run(
                    span,
                    self._flags(bits),
                    coolant_degc=coolant_degc,
                    speed_km_h=speed_km_h,
                    until_ns=until_ns,
                    found=found,
                )
                continue
            self._denominator.interrupt()
            if heard not in _UNKNOWN:
                elapsed_ns = until_ns.item(end) - until_ns.item(begin)
                is_silent = heard == Quality.STALE
                self._engine.stand(elapsed_ns, is_silent=is_silent, is_standing=bool(stands))
        return found

    def _codes(self, block: SampleBlock) -> NDArray[np.uint16]:
        """Return an integer for each sample, (n,): samples with the same one are alike."""
        codes = np.multiply(self._thresholds.masks(block.values), _N_QUALITIES, dtype=np.uint16)
        codes += block.quality[:, self._heard]
        return codes

    def _flags(self, bits: int) -> Flags:
        return Flags(
            self._vehicle is not None and bool(bits & _MOVES),
            self._vehicle is not None and bits & (_SPEED_KNOWN | _ROLLS) == _SPEED_KNOWN,
            (self._ambient is None or bool(bits & _MILD))
            and (self._pressure is None or bool(bits & _LOW)),
            self._coolant is not None and bool(bits & _WARM),
        )

    def _run(
        self,
        span: DrivenSpan,
        flags: Flags,
        coolant_degc: FloatArray | None,
        speed_km_h: FloatArray | None,
        until_ns: IntArray,
        found: Counting,
    ) -> None:
        """Take samples that are alike, the engine running."""
        started, is_next = self._engine.run()
        if is_next:
            self._begin()
            found.moments.append((span.begin, "driving_cycle"))
        driven = span
        if started:  # the time since the last sample is not driven
            self._start_ns = 0
            self._denominator.interrupt()
            driven = DrivenSpan(span.begin + 1, span.end, until_ns)
        reached: dict[Moment, int | None] = {}
        if "ignition_cycle" in self._due:
            is_long = self._start_ns >= self._start_least_ns
            reached["ignition_cycle"] = (
                span.begin if is_long else driven.reached(self._start_ns, self._start_least_ns)
            )
        if "warm_up" in self._due and coolant_degc is not None:
            reached["warm_up"] = self._warm_up(span, flags, coolant_degc)
        if "general_denominator" in self._due and driven.begin < driven.end:
            reached["general_denominator"] = self._denominator.push(driven, flags)
        self._start_ns += driven.elapsed_ns
        at: list[tuple[int, Moment]] = [(k, m) for m, k in reached.items() if k is not None]
        if at:
            self._due = self._due.difference(moment for _, moment in at)
            found.moments.extend(sorted(at, key=lambda each: (each[0], _ORDER.index(each[1]))))
        if driven.begin < driven.end:
            self._drive(driven, speed_km_h, until_ns, found)

    def _warm_up(self, span: DrivenSpan, flags: Flags, coolant_degc: FloatArray) -> int | None:
        """Return where the coolant is warm and has risen enough since the engine's start."""
        if not flags.is_warm and not math.isnan(self._first_degc):
            return None
        inside = coolant_degc[span.begin : span.end]
        if math.isnan(self._first_degc):
            known = np.flatnonzero(inside == inside)  # noqa: PLR0124
            if not known.size:
                return None
            self._first_degc = inside.item(known.item(0))
        if not flags.is_warm:
            return None
        rise_degc = self._profile.warm_up_rise_degc
        if not np.fmax.reduce(inside) - self._first_degc >= rise_degc:
            return None
        return span.begin + int(np.argmax(inside - self._first_degc >= rise_degc))

    def _drive(
        self, span: DrivenSpan, speed_km_h: FloatArray | None, until_ns: IntArray, found: Counting
    ) -> None:
        """Count running time and distance whenever a whole second has passed."""
        before_ns, self._run_ns = self._run_ns, self._run_ns + span.elapsed_ns
        totals_km = None
        if speed_km_h is not None:
            totals_km = self._totals_km(span, speed_km_h, until_ns)
            self._run_km = totals_km.item(-1)
        if self._run_ns // _SECOND_NS == before_ns // _SECOND_NS:
            return
        run_ns = until_ns[span.begin : span.end + 1] - until_ns[span.begin] + before_ns
        seconds = run_ns // _SECOND_NS
        run_ns = run_ns[1:]
        for k in (seconds[1:] != seconds[:-1]).nonzero()[0].tolist():
            now_ns, now_km = run_ns.item(k), 0.0 if totals_km is None else totals_km.item(k)
            driven = Driven((now_ns - self._taken_ns) * 1e-9, now_km - self._taken_km)
            found.driven.append((span.begin + k, driven))
            self._taken_ns, self._taken_km = now_ns, now_km

    def _totals_km(
        self, span: DrivenSpan, speed_km_h: FloatArray, until_ns: IntArray
    ) -> FloatArray:
        """Return the distance of the driving cycle after each sample."""
        if span.end - span.begin == 1:  # the sum of a single addend: no array is needed
            speed = speed_km_h.item(span.begin)
            moved_km = speed * span.elapsed_ns * _HOURS_PER_NS if speed > 0.0 else 0.0
            return np.array([moved_km + self._run_km])
        totals_km = np.fmax(speed_km_h[span.begin : span.end], 0.0)
        totals_km *= until_ns[span.begin + 1 : span.end + 1] - until_ns[span.begin : span.end]
        totals_km *= _HOURS_PER_NS
        totals_km[0] += self._run_km
        np.add.accumulate(totals_km, out=totals_km)
        return totals_km
