"""Faults put into a stream of frames: the sensor's in the lambda signal, and those of the bus.

Time comes with the frames, so a log and a bus are treated alike, and the same seed gives the same
frames. A fault begins and ends by seconds after the first frame.
"""

import heapq
import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from monitor.bus_map import BusMap
from monitor.errors import SignalMapError, UsageError
from monitor.faults import (
    DEFAULT_DISTURBANCE,
    DEFAULT_SEVERITY,
    DropOuts,
    Fault,
    Noise,
    TimedSensorFault,
    resolve,
)
from monitor.rewrite import MessageWriter, writers
from monitor.signals import OUTPUT
from monitor.types import Frame

READY: Final = "sensor_ready"
INVALID: Final = "signal_invalid"  # the ECU says not available although the sensor is ready
FRAME_FAULTS: Final = {
    "frame_loss": 0.1,  # share of frames
    "frame_delay": 0.1,  # s
    "frame_duplication": 0.1,  # share of frames
    "frame_corruption": 0.1,  # share of frames
    "frame_flood": 200.0,  # frames/s
}
SHARES: Final = ("frame_loss", "frame_duplication", "frame_corruption", "drop_outs")
NAMES: Final = (*DEFAULT_SEVERITY, INVALID, *DEFAULT_DISTURBANCE, *FRAME_FAULTS)
MOST_FRAMES_PER_S: Final = 20_000.0
ALL: Final = "all"

Key = tuple[int, bool]  # identifier, whether it has 29 bits


@dataclass(frozen=True, slots=True)
class Injection:
    """One fault, when it acts and how strong it is.

    Raises UsageError for an unknown name or impossible values.
    """

    name: str
    severity: float
    start_s: float = 0.0  # after the first frame
    end_s: float = math.inf
    messages: tuple[str, ...] = ()  # of a frame fault: names or "all"; () is that of lambda
    can_id: int = 0  # of frame_flood
    drives: tuple[int, ...] = ()  # numbers from 1; () is every drive

    def __post_init__(self) -> None:
        if self.name not in NAMES:
            raise UsageError(f"fault {self.name!r} is unknown; there are {', '.join(NAMES)}")
        if not 0.0 <= self.start_s < self.end_s or math.isinf(self.start_s):
            raise UsageError(
                f"fault {self.name}: acts from {self.start_s:g} s to {self.end_s:g} s, "
                "wanted a start from 0 on and an end after it"
            )
        if self.name in DEFAULT_SEVERITY:
            resolve(self.name, self.severity)
        elif not (math.isfinite(self.severity) and self.severity > 0.0):
            raise UsageError(f"fault {self.name}: severity {self.severity} is not positive")
        if self.name in SHARES and self.severity > (1.0 if self.name != "drop_outs" else 0.95):
            raise UsageError(f"fault {self.name}: severity {self.severity:g} is a share, too large")
        if self.name == "frame_flood" and self.severity > MOST_FRAMES_PER_S:
            raise UsageError(f"fault frame_flood: at most {MOST_FRAMES_PER_S:g} frames/s")
        if self.messages and (self.name not in FRAME_FAULTS or self.name == "frame_flood"):
            raise UsageError(f"fault {self.name}: messages are for faults of frames")
        if self.can_id and self.name != "frame_flood":
            raise UsageError(f"fault {self.name}: can_id is for frame_flood")
        if not 0 <= self.can_id < 1 << 29:
            raise UsageError(f"fault {self.name}: can_id 0x{self.can_id:X} has more than 29 bits")

    @classmethod
    def of(cls, name: str, severity: float | None = None, **others: object) -> "Injection":
        """Return the injection with the name's usual severity if none is given."""
        usual = DEFAULT_SEVERITY | {INVALID: 1.0} | DEFAULT_DISTURBANCE | FRAME_FAULTS
        return cls(name, usual.get(name, 1.0) if severity is None else severity, **others)  # type: ignore[arg-type]

    def __str__(self) -> str:
        end = f" to {self.end_s:g} s" if math.isfinite(self.end_s) else ""
        begin = f" from {self.start_s:g} s" if self.start_s or end else ""
        return f"{self.name}={self.severity:g}{begin}{end}"


@dataclass(slots=True)
class _Active:
    """An injection with its state."""

    what: Injection
    start_ns: int
    end_ns: float
    random: random.Random
    sensor: TimedSensorFault | Noise | DropOuts | None = None
    fault: Fault | None = None
    keys: frozenset[Key] | None = None  # of a frame fault; None is every message

    def acts(self, t_ns: int) -> bool:
        return self.start_ns <= t_ns < self.end_ns


@dataclass(slots=True)
class Counts:
    """What was done to the frames."""

    taken: int = 0
    given: int = 0
    changed: Counter[str] = field(default_factory=Counter)  # by what was done

    def lines(self) -> Iterator[str]:
        """Yield what to print."""
        done = ", ".join(f"{name} {n}" for name, n in sorted(self.changed.items()) if n)
        yield f"{self.taken} frames from the ECU, {self.given} passed on" + (
            f"; {done}" if done else ""
        )


class Injector:
    """Takes the ECU's frames and gives those that go out.

    seed : of everything random
    keep_counters : give the alive counters no gaps or repetitions of the injector's own making
    Raises UsageError or SignalMapError if a fault cannot be put into these messages.
    """

    def __init__(
        self,
        bus_map: BusMap,
        injections: Sequence[Injection],
        *,
        seed: int = 0,
        keep_counters: bool = False,
    ) -> None:
        self._map, self._injections = bus_map, tuple(injections)
        self._seed, self._keep = seed, keep_counters
        self._writers = writers(bus_map.channels)
        self._lambda = _writer_of(bus_map, self._writers, OUTPUT)
        self._signal = self._lambda.signals[OUTPUT]
        self._check()
        self.counts = Counts()
        self._t0_ns: int | None = None
        self._waiting: list[tuple[int, int, Frame]] = []
        self._order = 0
        self._shift: Counter[Key] = Counter()  # what is added to a message's counter
        self._held = math.nan  # the last reading sent, for messages that cannot say not available
        self._active: list[_Active] = []
        self._floods: list[list[float]] = []

    def _check(self) -> None:
        names = {each.name for each in self._injections}
        can_say_so = READY in self._map.channels or self._signal.can_be_missing
        if "not_ready" in names and not can_say_so:
            raise SignalMapError(
                f"{self._signal.channel.map_path}: not_ready needs {READY} or a lambda that "
                "can be not available"
            )
        if INVALID in names and not self._signal.can_be_missing:
            self._signal.write(b"", math.nan)
        for each in self._injections:
            self._keys(each)

    def _keys(self, what: Injection) -> frozenset[Key] | None:
        if ALL in what.messages:
            return None
        known = {writer.name: key for key, writer in self._writers.items()}
        unknown = [name for name in what.messages if name not in known]
        if unknown:
            raise UsageError(
                f"fault {what.name}: message {unknown[0]!r} is not in the signal map; "
                f"there are {', '.join(known)} and all"
            )
        return frozenset(known[name] for name in what.messages or (self._lambda.name,))

    def _begin(self, t_ns: int) -> None:
        self._t0_ns = t_ns
        for number, what in enumerate(self._injections):
            each = _Active(
                what,
                t_ns + round(what.start_s * 1e9),
                t_ns + what.end_s * 1e9,
                random.Random(f"{self._seed}/{number}"),
            )
            if what.name in DEFAULT_SEVERITY:
                each.fault = resolve(what.name, what.severity)
                each.sensor = TimedSensorFault(each.fault)
            elif what.name == "noise":
                each.sensor = Noise(what.severity, f"{self._seed}/{number}")
            elif what.name == "drop_outs":
                each.sensor = DropOuts(what.severity, f"{self._seed}/{number}")
            elif what.name in FRAME_FAULTS:
                each.keys = self._keys(what)
            self._active.append(each)
            if what.name == "frame_flood":
                self._floods.append([float(each.start_ns), number])

    def push(self, frame: Frame) -> list[Frame]:
        """Take a frame of the ECU; return the frames that go out now, in the order of time."""
        if self._t0_ns is None:
            self._begin(frame.t_ns)
        self.counts.taken += 1
        out = self.advance(frame.t_ns)
        passed = self._frame_faults(frame)
        self.counts.given += len(passed)
        return out + passed if out else passed

    def advance(self, t_ns: int) -> list[Frame]:
        """Return the frames that are due without one of the ECU's: delayed ones and the flood."""
        if not self._waiting and not self._floods:
            return []
        for flood in self._floods:
            each = self._active[int(flood[1])]
            while flood[0] <= t_ns and flood[0] < each.end_ns:
                self._wait(round(flood[0]), self._flooding(each, round(flood[0])))
                flood[0] += 1e9 / each.what.severity
        out = []
        while self._waiting and self._waiting[0][0] <= t_ns:
            out.append(heapq.heappop(self._waiting)[2])
        self.counts.given += len(out)
        return out

    @property
    def due_ns(self) -> float:
        """Return when ``advance`` has something to give, inf if nothing is to come."""
        times = [
            flood[0] for flood in self._floods if flood[0] < self._active[int(flood[1])].end_ns
        ]
        if self._waiting:
            times.append(self._waiting[0][0])
        return min(times, default=math.inf)

    def flush(self) -> list[Frame]:
        """Return the delayed frames that are left at the end."""
        out = [frame for _, _, frame in sorted(self._waiting)]
        self._waiting.clear()
        self.counts.given += len(out)
        return out

    def stream(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Yield all that goes out for a whole log."""
        for frame in frames:
            yield from self.push(frame)
        yield from self.flush()

    def _frame_faults(self, frame: Frame) -> list[Frame]:
        key = (frame.can_id, frame.is_extended)
        writer = self._writers.get(key)
        acting = [each for each in self._active if each.acts(frame.t_ns)]
        sound = writer is not None and writer.is_sound(frame.data)
        is_lambda = writer is self._lambda
        if is_lambda and any(each.fault and each.fault.missing for each in acting):
            self._dropped(key, 1)
            self.counts.changed["left out"] += 1
            return []
        data = frame.data
        if writer is not None and sound and acting:
            data = self._rewrite(writer, frame, acting)
        elif is_lambda and not sound:
            self.counts.changed["unsound, left as it is"] += 1
        copies, corrupt, delay_s = 1, 0, 0.0
        for each in acting:
            name = each.what.name
            if name not in FRAME_FAULTS or (each.keys is not None and key not in each.keys):
                continue
            if name == "frame_delay":
                delay_s += each.what.severity
            elif name == "frame_flood" or each.random.random() >= each.what.severity:
                continue
            elif name == "frame_loss":
                copies = 0
            elif name == "frame_duplication":
                copies += 1 if copies else 0
            elif data:
                corrupt ^= 1 << each.random.randrange(8 * len(data))
        return self._sent(frame, key, data, copies, corrupt, delay_s, sound)

    def _sent(
        self,
        frame: Frame,
        key: Key,
        data: bytes,
        copies: int,
        corrupt: int,
        delay_s: float,
        sound: bool,
    ) -> list[Frame]:
        changed = self.counts.changed
        if copies == 0:
            changed["lost"] += 1
            self._dropped(key, 1)
            return []
        out = []
        for copy in range(copies):
            payload = data
            if copy:
                changed["duplicated"] += 1
                self._dropped(key, -1)
            if sound and self._shift[key]:
                payload = self._writers[key].write(payload, {}, self._shift[key])
            if corrupt:
                changed["corrupted"] += 1
                word = int.from_bytes(payload, "little") ^ corrupt
                payload = word.to_bytes(len(payload), "little")
            out.append(frame if payload == frame.data else frame._replace(data=payload))
        if not delay_s:
            return out
        changed["delayed"] += len(out)
        for each in out:
            t_ns = each.t_ns + round(delay_s * 1e6) * 1000
            self._wait(t_ns, each._replace(t_ns=t_ns))
        return []

    def _dropped(self, key: Key, n: int) -> None:
        if self._keep:
            self._shift[key] -= n

    def _rewrite(self, writer: MessageWriter, frame: Frame, acting: Sequence[_Active]) -> bytes:
        values: dict[str, float] = {}
        if any(each.fault and each.fault.not_ready for each in acting) and READY in writer.signals:
            values[READY] = 0.0
        if writer is self._lambda and self._signal.is_in(frame.data):
            healthy = self._signal.read(frame.data)
            read = self._reading(frame.t_ns, healthy, acting)
            if read != healthy and not (math.isnan(read) and math.isnan(healthy)):
                values[OUTPUT] = read
        if not values:
            return frame.data
        data = writer.write(frame.data, values)
        self.counts.changed["rewritten"] += data != frame.data
        return data

    def _reading(self, t_ns: int, healthy: float, acting: Sequence[_Active]) -> float:
        read = healthy
        for each in acting:
            if each.sensor is not None and not (each.fault and each.fault.not_ready):
                read = each.sensor.push(t_ns, read)
            elif each.fault or each.what.name == INVALID:
                read = math.nan
        if math.isnan(read) and not self._signal.can_be_missing:
            read = self._held if not math.isnan(self._held) else healthy
        self._held = read
        return read

    def _flooding(self, each: _Active, t_ns: int) -> Frame:
        self.counts.changed["flooded"] += 1
        can_id = each.what.can_id
        return Frame(t_ns // 1000 * 1000, can_id, can_id > 0x7FF, each.random.randbytes(8))

    def _wait(self, t_ns: int, frame: Frame) -> None:
        self._order += 1
        heapq.heappush(self._waiting, (t_ns, self._order, frame))


def _writer_of(bus_map: BusMap, by_key: dict[Key, MessageWriter], name: str) -> MessageWriter:
    if name not in bus_map.channels:
        where = ", ".join(str(map_path) for _, map_path in bus_map.pairs)
        raise SignalMapError(f"{where}: {name} is in no message, so no fault can be put into it")
    message = bus_map.channels[name].message
    return by_key[(message.frame_id, message.is_extended_frame)]
