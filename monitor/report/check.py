"""Checks a log or a bus: is every mapped signal present and plausible?"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from monitor.base.config import Config
from monitor.base.counts import counted, plain
from monitor.base.signals import BY_NAME
from monitor.base.types import FloatArray, FrameBlock, IntArray, SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.decode.log_blocks import EngineAnswers
from monitor.frames.blocks import EXTENDED
from monitor.frames.loop_frames import LOG_GAP_ID
from monitor.grid.timeline import Timeline
from monitor.judge.causes.causes import Asked, Cause, causes, timeout_of
from monitor.judge.causes.observation import Observation
from monitor.judge.electrical.plausibility import ENGINE
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

    def take(self, t_ns: IntArray, values: FloatArray) -> None:
        """Take values, (n,) at least one; NaN means not available, infinity out of range."""
        before_ns = t_ns[0] if self.heard_ns is None else self.heard_ns
        steps_ns = np.diff(t_ns, prepend=before_ns)
        self.longest_ns = max(self.longest_ns, int(steps_ns.max()))
        self.stale += int(np.count_nonzero(steps_ns > self.timeout_ns))
        self.heard_ns = int(t_ns[-1])
        good = np.isfinite(values)
        self.invalid += int(np.count_nonzero(np.isnan(values)))
        self.out_of_range += int(np.count_nonzero(np.isinf(values)))
        if good.any():
            t_ns, values = t_ns[good], values[good]
            if not self.count:
                self.first_ns = int(t_ns[0])
            self.count += len(values)
            self.minimum = min(self.minimum, float(values.min()))
            self.maximum = max(self.maximum, float(values.max()))
            self.last_ns = int(t_ns[-1])

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
            f"STALE {counted(self.stale, 'time')}, values up to {plain(age_s, 3)} s old, "
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
            kept_out = "out of range" if self.out_of_range else "MISSING"
            return "not available" if self.invalid else kept_out
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

    def standing(self, running_rpm: float) -> str:
        """Return in words that the engine was off, "" if it ran or nothing tells its speed."""
        speeds = [s.maximum for s in self.signals if s.name == ENGINE and s.count]
        if not speeds or speeds[0] >= running_rpm:
            return ""
        return f"the engine is off ({ENGINE} at most {plain(speeds[0])}): check again while it runs"

    def lines(self) -> Iterator[str]:
        """Yield the lines of the table."""
        numbers = f"{'rate':>8}{'age':>8}{'minimum':>12}{'maximum':>12}"
        yield f"{'signal':<28}{'unit':<11}{numbers}  verdict"
        for s in self.signals:
            if s.count:
                age_s = (self.end_ns - s.last_ns) / 1e9
                numbers = (
                    f"{s.rate_hz:6.1f}/s{age_s:6.2f} s{plain(s.minimum):>12}{plain(s.maximum):>12}"
                )
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


def check(blocks: Iterable[FrameBlock], bus_map: BusMap, silent_s: float = 0.0) -> CheckResult:
    """Return counts and range of every mapped signal over the frames.

    silent_s : for how long nothing has come since
    Optional signals are among them if they came.
    """
    decoder = BlockDecoder(bus_map, (*bus_map.names, *bus_map.optional))
    seen = [
        SignalSeen(name, BY_NAME[name].unit if name in BY_NAME else "", timeout_ns)
        for name, timeout_ns in zip(decoder.channels, decoder.timeouts_ns, strict=True)
    ]
    n = end_ns = 0
    for block in Timeline(decoder).blocks(map(EngineAnswers(decoder.plans).push, blocks)):
        n += int(np.count_nonzero(block.key != LOG_GAP_ID | EXTENDED))
        end_ns = max(end_ns, int(block.t_ns.max(initial=0)))
        for part in decoder.push(block):
            for index, values in zip(part.channels, part.values, strict=True):
                if len(values):
                    seen[index].take(block.t_ns[part.rows], values)
    reasons, every = ("length", "checksum", "stuck", "lost"), decoder.counters.values()
    rejected = {reason: sum(getattr(c, reason) for c in every) for reason in reasons}
    derived = {d.name: d.sources for d in decoder.derived}
    there = tuple(
        s for s in seen if s.name not in bus_map.optional or s.count or s.invalid or s.out_of_range
    )
    return CheckResult(there, n, end_ns + round(silent_s * 1e9), rejected, derived)
