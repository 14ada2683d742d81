"""Fuzz frame times, in replays (with and without alive counters) and through the live loop.

The clock of a healthy drive is set back and forward and its frames are stamped wrongly. Their
content stays sound, so that a code, a driving cycle or a crash is a failure. So is a recording of
the live loop whose replay says anything else than the loop did.

python -m benchmarks fuzz_times [--cases 10000000] [--seconds 600]
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import can
import numpy as np

from benchmarks.damage.harness import fuzz_options
from benchmarks.outcome import finish, say
from benchmarks.repository import REPLAY_LOGS
from monitor.base import config
from monitor.base.types import FrameBlock
from monitor.bus.link.recorder import message_of
from monitor.bus.loop import Loop
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.signal_map import Integrity
from monitor.frames.blocks import chosen, frames_of, joined
from monitor.frames.logs import read_blocks
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, log_samples
from monitor.grid.time_walk import TimeCounters
from monitor.grid.timeline import Timeline
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline import replay
from monitor.pipeline.collector import Collector
from monitor.pipeline.events import CycleStarted, Event
from monitor.pipeline.monitor import Judge, SensorMonitor, slices
from monitor.pipeline.names import needed_names

LOG = REPLAY_LOGS / "healthy_micro_trips_v102_s102.blf"
BEGIN_NS = 1_700_000_000_000_000_000
S = 1_000_000_000
SMALLEST_S, LARGEST_S = 1e-3, 1e6  # of the jumps
RATES = (1e-5, 1e-4, 1e-3, 1e-2)  # jumps per frame
ADJACENT = 5  # most wrong stamps in a row
DELAY_S = 0.002  # mean delay from stamp to arrival
STALL_S = 2.0  # longest time in which the interface delivers nothing; a longer one is a fault


@dataclass(frozen=True, slots=True)
class DriveFindings:
    """What the monitor made of a drive."""

    codes: tuple[str, ...]
    cycles: int  # driving cycles that began within the drive
    judged: dict[str, Any]  # what a replay must repeat
    times: TimeCounters


def healthy(seconds: float | None = None, log: Path = LOG) -> FrameBlock:
    """Return the frames of a healthy drive, the first so many seconds."""
    whole = joined(list(read_blocks(log)))
    whole = whole._replace(t_ns=whole.t_ns - whole.t_ns[0] + BEGIN_NS)
    if seconds is None:
        return whole
    return chosen(whole, whole.t_ns < BEGIN_NS + round(seconds * S))


def jumping(
    frames: FrameBlock, rng: np.random.Generator, rate: float, kind: str = "both"
) -> FrameBlock:
    """Return frames whose times jump, ``rate`` times per frame.

    kind : "steps" of the clock, "stamps" that are wrong, or "both"
    """
    n = len(frames.t_ns)
    places = np.flatnonzero(rng.random(n) < rate)
    if places.size == 0:
        places = rng.integers(0, n, 1)
    wrong_ns = np.zeros(n, dtype=np.int64)
    for place in places.tolist():
        size_s = np.exp(rng.uniform(np.log(SMALLEST_S), np.log(LARGEST_S)))
        jump_ns = round(size_s * 1e6 * rng.choice((-1, 1))) * 1000
        if kind == "steps" or (kind == "both" and rng.random() < 0.5):
            wrong_ns[place:] += jump_ns
        else:
            wrong_ns[place : place + int(rng.integers(1, ADJACENT + 1))] += jump_ns
    return frames._replace(t_ns=frames.t_ns + wrong_ns)


def without_counters(setup: replay.Setup) -> replay.Setup:
    """Return a setup whose map does not say where the alive counters are."""
    channels = {
        name: replace(channel, integrity=Integrity())
        for name, channel in setup.bus_map.channels.items()
    }
    return replace(setup, bus_map=replace(setup.bus_map, channels=channels))


def _summary(entry: dict[str, Any]) -> dict[str, Any]:
    keys = ("samples", "enabled_samples", "windows", "dtcs", "fault_flag", "completed", "enable")
    return {key: entry[key] for key in keys}


def replayed(frames: FrameBlock, setup: replay.Setup, size: int = 1 << 16) -> DriveFindings:
    """Judge frames as a log is judged, in blocks of a size."""
    store = DtcStore(profile=setup.config.profile)
    store.start_driving_cycle()
    names = needed_names(setup.model.card, setup.bus_map.names)
    decoder = BlockDecoder(setup.bus_map, names)
    assembler = BlockAssembler.of(decoder, setup.model.card.period_ns)
    timeline = Timeline(decoder)
    monitor = SensorMonitor(Judge(names, setup.model, setup.config), setup.limits, store)
    collector, cycles = Collector(monitor), 0
    n = len(frames.t_ns)
    cut = (chosen(frames, slice(first, first + size)) for first in range(0, n, size))
    for part in log_samples(timeline.blocks(cut), decoder, assembler):
        if isinstance(part, Clearing):
            continue
        for block in slices(part, 0, len(part.t_ns)):
            for event in monitor.push(block):
                cycles += isinstance(event, CycleStarted)
                collector.push(event)
    entry = collector.result("fuzz", None, {})
    codes = tuple(dtc.code for dtc in store.active)
    return DriveFindings(codes, cycles, _summary(entry), timeline.counters)


class Arriving(can.BusABC):
    """Gives frames at their times of arrival; its clock is theirs."""

    def __init__(self, frames: FrameBlock, arrivals_s: list[float]) -> None:
        super().__init__(channel="arriving")
        self.channel_info = "arriving"
        self.now_s = 0.0
        self.loop: Loop | None = None
        self._items = iter(zip(frames_of(frames), arrivals_s, strict=True))
        self._next = next(self._items, None)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self._next is None:
            if self.loop:
                self.loop.stop()
            return None
        frame, at_s = self._next
        if at_s > self.now_s + (timeout or 0.0):
            self.now_s += timeout or 0.0
            return None
        self.now_s = max(self.now_s, at_s)
        self._next = next(self._items, None)
        return message_of(frame)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Take nothing."""


class Listening(Loop):
    """A loop that keeps what it judges, and counts driving cycles."""

    def __init__(self, bus: can.BusABC, setup: replay.Setup, **options: Any) -> None:
        super().__init__(bus, setup, say=lambda _: None, **options)
        self.judged: list[FrameBlock] = []
        self.cycles = 0

    def _judge(self, block: FrameBlock) -> None:
        self.judged.append(block)
        super()._judge(block)

    def _tell(self, event: Event) -> None:
        self.cycles += isinstance(event, CycleStarted)
        super()._tell(event)


def arrivals(t_ns: np.ndarray, rng: np.random.Generator) -> list[float]:
    """Return when frames with these true times arrive: a little late, at times very late."""
    true_s = (t_ns - BEGIN_NS) / 1e9
    arrived_s = true_s + rng.exponential(DELAY_S, len(true_s))
    for _ in range(rng.integers(0, 3)):
        begin_s = rng.uniform(0.0, true_s[-1])
        end_s = min(begin_s + rng.uniform(0.0, STALL_S), true_s[-1])
        stalled = (true_s >= begin_s) & (true_s < end_s)
        arrived_s[stalled] = np.maximum(arrived_s[stalled], end_s)
    found: list[float] = np.maximum.accumulate(arrived_s).tolist()
    return found


def lived(frames: FrameBlock, arrivals_s: list[float], setup: replay.Setup) -> DriveFindings:
    """Judge frames through the live loop; a replay of its recording must say the same."""
    bus = Arriving(frames, arrivals_s)
    with bus:
        loop = bus.loop = Listening(bus, setup, monotonic_s=lambda: bus.now_s)
        loop.run()
    entry = loop.result("fuzz")
    codes = tuple(dtc["code"] for dtc in entry["dtcs"])
    found = DriveFindings(codes, loop.cycles, _summary(entry), loop.clock.counters)
    again = replayed(joined(loop.judged), setup)
    if again.judged != found.judged or again.cycles != found.cycles:
        raise AssertionError(f"the recording's replay differs: {again.times}")
    return found


def drives(
    n: int, seed: int, setup: replay.Setup, frames: FrameBlock
) -> Iterator[tuple[str, str, DriveFindings, float]]:
    """Yield form, what was done, findings and seconds, until ``n`` frames are judged."""
    bare = without_counters(setup)
    for number in range(seed, seed + -(-n // len(frames.t_ns))):
        rng = np.random.default_rng(number)
        rate, kind = rng.choice(RATES), str(rng.choice(("steps", "stamps", "both")))
        jumped = jumping(frames, rng, rate, kind)
        form = ("replay", "replay without counters", "live")[number % 3]
        begin_s = time.process_time()
        if form == "live":
            found = lived(jumped, arrivals(frames.t_ns, rng), setup)
        else:
            found = replayed(jumped, setup if form == "replay" else bare)
        yield form, f"seed {number}, {kind}, {rate:g}", found, time.process_time() - begin_s


def main(argv: Sequence[str]) -> int:
    """Fuzz and count; return 1 if a drive has a false code or driving cycle."""
    options = fuzz_options(__name__, __doc__, 10_000_000, 30_000)
    options.add_argument("--seconds", type=float, help="of the drive; by default all")
    args = options.parse_args(argv)
    seconds = 50.0 if args.smallest else args.seconds
    setup, frames = replay.set_up(None, (), config.load()), healthy(seconds)
    sums, missed = dict[str, Counter[str]](), []
    for form, what, found, took_s in drives(args.cases, args.seed, setup, frames):
        false = bool(found.codes or found.cycles)
        sums.setdefault(form, Counter()).update(
            frames=len(frames.t_ns),
            windows=len(found.judged["windows"]),
            clock_steps=found.times.clock_steps,
            log_gaps=found.times.log_gaps,
            outliers=found.times.outliers,
            false=false,
            cpu_ms=round(1e3 * took_s),
        )
        if false:
            missed.append(f"{form}, {what}: codes {found.codes}, driving cycles {found.cycles}")
            say(missed[-1])
    return finish(args, [{"form": form} | dict(sums[form]) for form in sums], missed)
