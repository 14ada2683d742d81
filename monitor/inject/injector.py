"""Injects sensor faults into the lambda signal, and faults into frames.

Time comes with the frames, so a log and a bus are handled alike, and the same seed gives the same
frames. Begin and end of a fault count in seconds from the first frame.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from monitor.base.counts import counted
from monitor.base.errors import SignalMapError
from monitor.base.fault_streams import DropOuts, NoiseFault, TimedSensorFault
from monitor.base.faults import DEFAULT_SEVERITY, resolve
from monitor.base.signals import OUTPUT
from monitor.base.types import Frame
from monitor.decode.bus_map import BusMap
from monitor.decode.log_blocks import EngineAnswers, keys_of
from monitor.decode.obd_answers import ANSWER
from monitor.decode.parameter_groups import mask_of
from monitor.frames.loop_frames import is_own
from monitor.inject.frame_faults import FrameFaults
from monitor.inject.injection import FRAME_FAULTS, INVALID, Injection, check_begun
from monitor.inject.rewrite import MessageWriter, writers

READY: Final = "sensor_ready"
DUTY: Final = "sensor_heater_percent"


@dataclass(slots=True)
class InjectionCounts:
    """Counts of incoming, outgoing and changed frames."""

    taken: int = 0
    given: int = 0
    changed: Counter[str] = field(default_factory=Counter)  # by kind of change
    kept: Counter[str] = field(default_factory=Counter)  # by the reason why no fault is in them

    def lines(self) -> Iterator[str]:
        """Yield the counts as text."""
        told = sorted((self.changed + self.kept).items())
        done = ", ".join(f"{name} {n}" for name, n in told)
        taken = counted(self.taken, "frame")
        yield f"{taken} from the ECU, {self.given} passed on; {done or 'none changed'}"


class SensorReading:
    """A sensor fault with its state; signal_invalid has no reading, so it reads NaN."""

    def __init__(self, what: Injection, seed: str) -> None:
        self.what = what
        self.fault = resolve(what.name, what.severity) if what.name in DEFAULT_SEVERITY else None
        self.is_missing = self.fault is not None and self.fault.missing
        self.told: dict[str, float] = {}  # what the ECU sends beside the reading, by signal
        if self.fault and self.fault.not_ready:
            self.told[READY] = 0.0
        if self.fault and self.fault.heater_dead:
            self.told[DUTY] = 100.0
        self._reading: TimedSensorFault | NoiseFault | DropOuts | None = None
        if self.fault:
            self._reading = TimedSensorFault(self.fault)
        elif what.name == "noise":
            self._reading = NoiseFault(what.severity, seed)
        elif what.name == "drop_outs":
            self._reading = DropOuts(what.severity, seed)

    def read(self, t_ns: int, healthy: float) -> float:
        """Return the faulty reading in lambda, NaN for not available."""
        return self._reading.push(t_ns, healthy) if self._reading else math.nan


class Injector:
    """Takes the ECU's frames and returns the outgoing ones.

    seed : seed of all random faults
    keep_counters : renumber alive counters, so that the injector's changes leave no gap
    Raises UsageError or SignalMapError if a fault is impossible in these messages.
    """

    def __init__(
        self,
        bus_map: BusMap,
        injections: Sequence[Injection],
        *,
        seed: int = 0,
        keep_counters: bool = False,
    ) -> None:
        if OUTPUT not in bus_map.channels:
            where = ", ".join(str(map_path) for _, map_path in bus_map.pairs)
            raise SignalMapError(f"{where}: {OUTPUT} is in no message to put a fault into")
        message = bus_map.channels[OUTPUT].message
        self._key = (message.frame_id, message.is_extended_frame)
        self._writers = writers(bus_map.channels)
        self._signal = self._writers[self._key].signals[OUTPUT]
        self._check(bus_map, {each.name for each in injections})
        if not any(each.name in FRAME_FAULTS for each in injections):  # nothing changes the others
            own = {OUTPUT, READY, DUTY}
            self._writers = {k: w for k, w in self._writers.items() if own & w.signals.keys()}
        # messages that come under several identifiers of 29 bits: one of them, mask, key
        self._groups = [(k[0], mask_of(k[0]), k) for k, w in self._writers.items() if w.any_source]
        answers = EngineAnswers(keys_of(c.message for c in bus_map.channels.values()))
        self._groups += [(*group, (ANSWER, False)) for group in answers.groups]
        self.counts, self._injections = InjectionCounts(), injections
        self._sensor = [
            SensorReading(what, f"{seed}/{number}")
            for number, what in enumerate(injections)
            if what.name not in FRAME_FAULTS
        ]
        self._frames = FrameFaults(
            injections,
            self._writers,
            self._key,
            self.counts.changed,
            seed=seed,
            keep_counters=keep_counters,
        )
        self._t0_ns: int | None = None
        self._held = math.nan  # last sent reading, for messages without "not available"

    def _check(self, bus_map: BusMap, names: set[str]) -> None:
        if self._signal.can_be_missing:
            return
        needs = {INVALID} | ({"not_ready", "heater"} if READY not in bus_map.channels else set())
        for name in sorted(names & needs):
            raise SignalMapError(
                f"{self._signal.channel.map_path}: {name} needs a {OUTPUT} that can be not "
                "available; not_available is not set"
            )

    def push(self, frame: Frame) -> list[Frame]:
        """Take a frame of the ECU; return the frames that go out now, in order of time."""
        if self._t0_ns is None:
            self._t0_ns = frame.t_ns
            self._frames.begin(frame.t_ns)
        self.counts.taken += 1
        due = self._frames.advance(frame.t_ns)
        return self._given(due + self._passed(frame, frame.t_ns - self._t0_ns))

    def advance(self, t_ns: int) -> list[Frame]:
        """Return the delayed and flooding frames that are due without a frame of the ECU."""
        return self._given(self._frames.advance(t_ns))

    @property
    def due_ns(self) -> float:
        """Return the time in ns of the next due frame, inf if there is none."""
        return self._frames.due_ns

    def flush(self) -> list[Frame]:
        """Return the remaining delayed frames at the end."""
        return self._given(self._frames.flush())

    def _given(self, out: list[Frame]) -> list[Frame]:
        self.counts.given += len(out)
        return out

    def stream(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Yield all outgoing frames of a log; raise UsageError if it ends before a fault begins."""
        last_ns = 0
        for frame in frames:
            last_ns = max(last_ns, frame.t_ns)
            yield from self.push(frame)
        check_begun(self._injections, last_ns - (self._t0_ns or 0))
        yield from self.flush()

    def _passed(self, frame: Frame, since_ns: int) -> list[Frame]:
        if is_own(frame):  # a recording of the loop: the bus never carried it
            return [frame]
        key = (frame.can_id, frame.is_extended)
        if frame.is_extended:
            own = (key for one, mask, key in self._groups if not (frame.can_id ^ one) & mask)
            key = next(own, key)
        writer = self._writers.get(key)
        if writer is None:
            return self._frames.push(frame, key, sound=False)
        sound = writer.is_sound(frame.data)
        if sound:
            writer.hear(frame.data)
        acting = [each for each in self._sensor if each.what.acts(since_ns)]
        is_gone = key == self._key and any(each.is_missing for each in acting)
        if is_gone and self._signal.is_in(frame.data):
            self._frames.left_out(key)
            self.counts.changed["left out"] += 1
            return []
        if sound and acting:
            frame = self._rewritten(writer, frame, acting)
        elif key == self._key and not sound:
            self.counts.kept["unsound, left as it is"] += 1
        return self._frames.push(frame, key, sound=sound)

    def _rewritten(
        self, writer: MessageWriter, frame: Frame, acting: Sequence[SensorReading]
    ) -> Frame:
        values = {n: v for each in acting for n, v in each.told.items() if n in writer.signals}
        if OUTPUT in writer.signals and self._signal.is_in(frame.data):
            healthy = self._signal.read(frame.data)
            read = self._read(frame.t_ns, healthy, acting)
            if read != healthy and not (math.isnan(read) and math.isnan(healthy)):
                values[OUTPUT] = read
        data = writer.write(frame.data, values)
        if data == frame.data:
            return frame
        self.counts.changed["rewritten"] += 1
        return frame._replace(data=data)

    def _read(self, t_ns: int, healthy: float, acting: Sequence[SensorReading]) -> float:
        read = healthy
        for each in acting:
            read = each.read(t_ns, read)
        if math.isnan(read) and not self._signal.can_be_missing:
            read = healthy if math.isnan(self._held) else self._held
        self._held = read
        return read
