"""Checks a log or a bus: is every mapped signal present and plausible?"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from monitor.base.config import Config
from monitor.base.counts import counted
from monitor.base.signals import BY_NAME
from monitor.base.types import Frame, SampleBlock
from monitor.decode.bus_map import BusMap
from monitor.decode.decoder import Decoder
from monitor.judge.causes.causes import Asked, Cause, causes, timeout_of
from monitor.judge.causes.observation import Observation
from monitor.judge.enable import Enable
from monitor.model.card import ModelCard
from monitor.pipeline.recordings import OpenRecording


@dataclass(slots=True)
class SignalSeen:
    """Counts, range and times of one signal's values."""

    name: str
    unit: str
    timeout_ns: int
    count: int = 0  # good values
    invalid: int = 0
    out_of_range: int = 0
    minimum: float = math.inf
    maximum: float = -math.inf
    first_ns: int = 0
    last_ns: int = 0
    heard_ns: int | None = None  # time of the last value, good or bad
    longest_ns: int = 0  # between two values
    stale: int = 0  # times that the next value came after the timeout

    def take(self, t_ns: int, value: float) -> None:
        """Take one value; NaN means not available, infinity out of range."""
        if self.heard_ns is not None:
            self.longest_ns = max(self.longest_ns, t_ns - self.heard_ns)
            self.stale += t_ns - self.heard_ns > self.timeout_ns
        self.heard_ns = t_ns
        if math.isnan(value):
            self.invalid += 1
        elif math.isinf(value):
            self.out_of_range += 1
        else:
            if not self.count:
                self.first_ns = t_ns
            self.count += 1
            self.minimum, self.maximum = min(self.minimum, value), max(self.maximum, value)
            self.last_ns = t_ns

    @property
    def rate_hz(self) -> float:
        """Return the mean rate of good values in Hz."""
        span_s = (self.last_ns - self.first_ns) / 1e9
        return (self.count - 1) / span_s if span_s > 0 else 0.0

    def is_present(self, end_ns: int) -> bool:
        """Return whether good values came until ``end_ns``."""
        return self.count > 0 and end_ns - self.last_ns <= self.timeout_ns

    @property
    def staleness(self) -> str:
        """Return how often values came too late, and the timeout that would hold them."""
        interval_s = 1.0 / self.rate_hz if self.rate_hz else self.longest_ns / 1e9
        age_s, timeout_s = self.longest_ns / 1e9, self.timeout_ns / 1e9
        return (
            f"STALE {counted(self.stale, 'time')}, values up to {age_s:.3g} s old, "
            f"timeout_s is {timeout_s:g}: "
            f"set timeout_s = {timeout_of(max(interval_s, age_s / 3.0)):g} in the map"
        )

    def verdict(self, end_ns: int) -> str:
        """Return the state of the signal in words, for a check that ends at ``end_ns``."""
        if self.count and not self.is_present(end_ns):
            age_s, timeout_s = (end_ns - self.last_ns) / 1e9, self.timeout_ns / 1e9
            return f"STOPPED {age_s:.1f} s before the end, timeout_s is {timeout_s:g}"
        if self.stale:
            return self.staleness
        if not self.count:
            return (
                "not available"
                if self.invalid
                else ("out of range" if self.out_of_range else "MISSING")
            )
        bad = self.invalid + self.out_of_range
        return "plausible" if bad <= 0.01 * self.count else f"{bad} bad values"


@dataclass(frozen=True, slots=True)
class CheckResult:
    """All signals of the map, and the time at which the check ended."""

    signals: tuple[SignalSeen, ...]
    frames: int
    end_ns: int
    rejected: dict[str, int]  # frames by reason
    derived: dict[str, tuple[str, ...]]  # name → signals from which it is computed

    def missing(self, needed: Iterable[str]) -> list[str]:
        """Return the needed signals without good values until the end."""
        seen = {s.name for s in self.signals if s.is_present(self.end_ns)}
        seen |= {name for name, sources in self.derived.items() if seen.issuperset(sources)}
        return [name for name in needed if name not in seen]

    @property
    def stale(self) -> list[str]:
        """Return the signals whose values came later than their timeout allows."""
        return [s.name for s in self.signals if s.stale]

    def lines(self) -> Iterator[str]:
        """Yield the lines of the table."""
        yield (
            f"{'signal':<28}{'unit':<11}{'rate':>8}{'age':>8}"
            f"{'minimum':>12}{'maximum':>12}  verdict"
        )
        for s in self.signals:
            if s.count:
                age_s = (self.end_ns - s.last_ns) / 1e9
                numbers = f"{s.rate_hz:6.1f}/s{age_s:6.2f} s{s.minimum:12.4g}{s.maximum:12.4g}"
            else:
                numbers = " " * 40
            yield f"{s.name:<28}{s.unit:<11}{numbers}  {s.verdict(self.end_ns)}"
        for name, sources in self.derived.items():
            yield f"{name:<28}made of {', '.join(sources)}"
        bad = ", ".join(f"{reason} {n}" for reason, n in self.rejected.items() if n)
        yield counted(self.frames, "frame") + (f"; rejected: {bad}" if bad else "")


def held_up(recording: OpenRecording, card: ModelCard, config: Config) -> list[Cause]:
    """Return the reasons that would keep a recording from its verdict.

    Raises RecordingError as the recording is read.
    """
    names, period_s = recording.names, card.period_ns * 1e-9
    enable = Enable.of(config.enable, names, card)
    observation = Observation(enable, names, config.plausibility, period_s)
    for part in recording.parts:
        if isinstance(part, SampleBlock):
            observation.push(part.values, part.quality, enable.push(part.values, part.quality))
    return causes(observation.observed(), Asked(card, config, recording.sources))


def check(frames: Iterable[Frame], bus_map: BusMap) -> CheckResult:
    """Return counts and range of every mapped signal over the frames.

    Optional signals are among them if they came.
    """
    decoder = Decoder(bus_map, (*bus_map.names, *bus_map.optional))
    seen = [
        SignalSeen(name, BY_NAME[name].unit if name in BY_NAME else "", timeout_ns)
        for name, timeout_ns in zip(decoder.channels, decoder.timeouts_ns, strict=True)
    ]
    n = end_ns = 0
    for frame in frames:
        n += 1
        end_ns = max(end_ns, frame.t_ns)
        update = decoder.push(frame)
        if update is not None:
            for index, value in zip(*update, strict=True):
                seen[index].take(frame.t_ns, value)
    rejected: dict[str, int] = {}
    for counters in decoder.counters.values():
        for reason in ("length", "checksum", "stuck", "lost"):
            rejected[reason] = rejected.get(reason, 0) + getattr(counters, reason)
    derived = {d.name: d.sources for d in decoder.derived}
    there = tuple(
        s for s in seen if s.name not in bus_map.optional or s.count or s.invalid or s.out_of_range
    )
    return CheckResult(there, n, end_ns, rejected, derived)
