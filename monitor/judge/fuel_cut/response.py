"""The test of the fuel-cut response: a drive's fuel cuts against those of healthy drives.

A drive shows by how much its steps are later and slower than predicted, and where its reading
stands in air. Healthy recordings show the same, with their spread from cut to cut and from drive to
drive; the model card holds it. A reading at the end of its range shows no level. Where healthy
readings stand there, one that does not get so far shows the most that the sensor's gain can be;
beside it, those that do get there count as healthy ones.
"""

import math
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from statistics import NormalDist, fmean
from typing import Any, Final, NamedTuple

from monitor.base.config import Config
from monitor.base.errors import ModelError
from monitor.judge.fuel_cut.air_pressure import AirPressure
from monitor.judge.fuel_cut.cuts import LEVEL, QUANTITIES, Cut, CutReading
from monitor.judge.response.rule import EDGES, Outcome
from monitor.memory.obd_records import TestResult

TEST: Final = "fuel_cut_response"
LATEST: Final = 8  # cuts of a drive that are judged, so that a fault that begins late shows
RISE_PER_LAG: Final = math.log(4.0)  # of a first-order lag, from 20 to 80 % of a step


@dataclass(frozen=True, slots=True)
class HealthyCuts:
    """What healthy drives show of one quantity, measured less predicted; of the level, its phi."""

    mean: float
    std: float  # of a fuel cut within its drive
    drive_std: float  # of drives


@dataclass(frozen=True, slots=True)
class FuelCutReference:
    """What the fuel cuts of healthy drives show."""

    healthy: Mapping[str, HealthyCuts] = field(default_factory=dict)  # by quantity
    is_clipped: bool = False  # the level is the end of the reading's range
    pressure: AirPressure | None = None  # how the level depends on it; None if it was not known

    def to_card(self) -> dict[str, Any]:
        """Return the reference for a model card."""
        return asdict(self)

    @classmethod
    def from_card(cls, data: Mapping[str, Any], where: str) -> "FuelCutReference | None":
        """Return the reference of a model card, None if it holds none.

        Raises ModelError naming the file if it cannot be read.
        """
        if not data:
            return None
        try:
            healthy = {
                name: HealthyCuts(*(float(each[key]) for key in ("mean", "std", "drive_std")))
                for name, each in data["healthy"].items()
            }
            is_clipped = bool(data["is_clipped"])
            told = data.get("pressure")  # older cards lack it
            pressure = told and AirPressure(
                *(float(told[key]) for key in ("kpa", "share", "share_std"))
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ModelError(
                f"{where}: the model card's fuel cuts cannot be read: {error}"
            ) from None
        if not healthy.keys() <= set(QUANTITIES):
            raise ModelError(f"{where}: the model card's fuel cuts have an unknown quantity")
        if any(min(each.std, each.drive_std) < 0.0 for each in healthy.values()):
            raise ModelError(f"{where}: the model card's fuel cuts have a negative spread")
        return cls(healthy, is_clipped, pressure)


class CutFinding(NamedTuple):
    """One quantity of a drive's latest fuel cuts; the level is in the output's unit."""

    cuts: int
    measured: float
    predicted: float
    low: float | None  # least and greatest that pass, None without a reference
    high: float | None
    verdict: Outcome
    std: float | None = None  # of ``measured`` in healthy drives


class FuelCutResponse:
    """Judges the fuel cuts of one drive.

    reference : of healthy drives; without one all is measured and nothing judged
    transform : of the model, "phi" or "none"
    """

    def __init__(self, config: Config, reference: FuelCutReference | None, transform: str) -> None:
        self._response, self._config = config.response, config.fuel_cut
        self._resolution = config.plausibility.stuck_range
        self._reference = reference or FuelCutReference()
        self._is_phi = transform == "phi"
        normal = NormalDist()
        self._z_fail = normal.inv_cdf(1.0 - self._response.false_alarm_probability)
        self._z_pass = normal.inv_cdf(1.0 - self._response.miss_probability)
        self._latest: defaultdict[str, deque[CutReading]] = defaultdict(
            lambda: deque(maxlen=LATEST)
        )
        self._pressures_kpa: deque[float] = deque(maxlen=LATEST)  # of the levels
        self._shows_level = False  # a level was not the end of the reading's range
        self.cuts: list[Cut] = []

    def add(self, cut: Cut) -> None:
        """Take a fuel cut that is over."""
        self.cuts.append(cut)
        for quantity, seen in cut.seen.items():
            self._latest[quantity].append(seen)
            if quantity == LEVEL:
                self._pressures_kpa.append(cut.pressure_kpa)
                self._shows_level |= not self._is_at_end(seen)

    def _is_at_end(self, level: CutReading) -> bool:
        """Return whether a level is the end of the reading's range."""
        end = self._reference.healthy.get(LEVEL)
        if end is None or not self._reference.is_clipped:
            return False
        return level.measured - end.mean <= self._resolution

    def findings(self) -> dict[str, CutFinding]:
        """Return the findings by quantity."""
        shown = [name for name in QUANTITIES if name in self._latest]
        return {name: self._finding(name) for name in shown if name != LEVEL or self._shows_level}

    @property
    def is_clipped(self) -> bool:
        """Return whether healthy readings in air stand at the end of their range."""
        return self._reference.is_clipped

    @property
    def gain(self) -> tuple[float, float] | None:
        """Return the sensor's gain by its level in air, and its standard deviation.

        It is the most that the gain can be where healthy readings stand at the end of their range.
        """
        healthy = self._reference.healthy.get(LEVEL)
        if healthy is None or not self._shows_level:
            return None
        latest, (span, spread) = self._latest[LEVEL], self._span(healthy)
        gain = (1.0 - fmean(each.measured for each in latest)) / span
        return gain, math.hypot(_std(healthy, len(latest)) / span, spread)

    def _span(self, healthy: HealthyCuts) -> tuple[float, float]:
        """Return the span of a healthy reading at the drive's pressure, its relative spread."""
        span, kpa = 1.0 - healthy.mean, fmean(self._pressures_kpa)
        pressure, spread = self._reference.pressure, self._config.pressure_spread
        if pressure is not None and math.isfinite(kpa):
            ratio, spread = pressure.span(kpa)
            span *= ratio
        return span, math.hypot(spread, self._config.humidity_spread)

    @property
    def faults(self) -> tuple[str, ...]:
        """Return the names of what is beyond its limits."""
        failed = [name for name, each in self.findings().items() if each.verdict == "failed"]
        kinds = {}  # a slow edge is also late
        for edge in EDGES:
            kinds[edge] = next(
                (kind for kind, what in _KINDS if f"{what}_{edge}_s" in failed), None
            )
        first, second = kinds.values()
        if first is not None and first == second:
            names = [f"{first}_symmetric"]
        else:
            names = [f"{kind}_{edge}" for edge, kind in kinds.items() if kind is not None]
        return (*names, *(["gain_low"] if LEVEL in failed else []))

    @property
    def verdict(self) -> Outcome:
        """Return the verdict: passed if all passes that healthy drives show."""
        found = {name: each.verdict for name, each in self.findings().items()}
        if "failed" in found.values():
            return "failed"
        wanted = set(self._reference.healthy) - ({LEVEL} if self.is_clipped else set())
        is_sound = bool(wanted) and all(found.get(name) == "passed" for name in wanted)
        return "passed" if is_sound else "inconclusive"

    def results(self) -> Iterator[TestResult]:
        """Yield the results of service $06."""
        for name, each in self.findings().items():
            if each.low is not None and each.high is not None:
                yield TestResult(TEST, name, each.measured, each.low, each.high)

    def _finding(self, name: str) -> CutFinding:
        latest = self._latest[name]
        measured, predicted = (fmean(values) for values in zip(*latest, strict=True))
        healthy = self._reference.healthy.get(name)
        if name == LEVEL:
            return self._level(measured, predicted)
        if healthy is None:
            return CutFinding(len(latest), measured, predicted, None, None, "inconclusive")
        limit = self._limit(name)
        beyond, std = measured - predicted - healthy.mean, _std(healthy, len(latest))
        verdict: Outcome = "inconclusive"
        if beyond > max(limit, self._z_fail * std):
            verdict = "failed"
        elif beyond < limit - self._z_pass * std:
            verdict = "passed"
        high = predicted + healthy.mean + limit
        return CutFinding(len(latest), measured, predicted, 0.0, high, verdict, std)

    def _limit(self, name: str) -> float:
        """Return how much later or slower than in healthy drives an edge may be, in s."""
        if name.startswith("delay"):
            return self._response.delay_limit_s
        return RISE_PER_LAG * self._response.lag_limit_s

    def _level(self, measured: float, predicted: float) -> CutFinding:
        n, own = len(self._latest[LEVEL]), self.gain
        shown = self._shown(measured), self._shown(predicted)
        if own is None:
            return CutFinding(n, *shown, None, None, "inconclusive")
        (gain, std), config = own, self._response
        verdict: Outcome = "inconclusive"
        if gain <= config.gain_weak_max and 1.0 - gain > self._z_fail * std:
            verdict = "failed"
        elif gain > config.gain_weak_max + self._z_pass * std:
            verdict = "passed"
        span, _ = self._span(self._reference.healthy[LEVEL])
        low, high = (
            self._shown(1.0 - each * span) for each in (config.gain_weak_max, config.gain_max)
        )
        shown_std = std * span * (shown[0] ** 2 if self._is_phi else 1.0)
        return CutFinding(n, *shown, low, high, verdict, shown_std)

    def _shown(self, level: float) -> float:
        """Return a level in the output's unit."""
        return 1.0 / max(level, _LEAST_PHI) if self._is_phi else -level


_KINDS: Final = (("slow", "rise"), ("delay", "delay"))
_LEAST_PHI: Final = 1.0 / 16.0  # of a lambda that is told


def _std(healthy: HealthyCuts, n: int) -> float:
    """Return the standard deviation of the mean of n cuts of a healthy drive."""
    return math.hypot(healthy.drive_std, healthy.std / math.sqrt(n))
