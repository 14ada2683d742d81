"""Faults of frames: lost, doubled, corrupted, late, and a flood of others."""

import heapq
import math
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from monitor.base.errors import UsageError
from monitor.base.types import Frame
from monitor.inject.injection import ALL, FRAME_FAULTS, Injection
from monitor.inject.rewrite import Key, MessageWriter

FLOOD: Final = "frame_flood"


@dataclass(slots=True)
class _Flood:
    """A flood and when its next frame is due."""

    what: Injection
    random: random.Random
    next_ns: float
    end_ns: float


@dataclass(slots=True)
class _Fault:
    """A fault of frames under some identifiers; None is all."""

    what: Injection
    random: random.Random
    keys: frozenset[Key] | None


@dataclass(slots=True)
class _Fate:
    """What becomes of one frame."""

    copies: int = 1
    flipped: int = 0  # bits, the first byte's lowest is bit 0
    delay_s: float = 0.0


class FrameFaults:
    """Takes frames one by one and gives those that go out, at once or when they are due.

    writers : of the messages that a fault may be for by name
    own : identifier of the message that a fault without names is for
    counts : is raised by what is done
    keep_counters : give the alive counters no gaps or repetitions by what is done here
    Raises UsageError if a fault names a message that is not there.
    """

    def __init__(
        self,
        injections: Sequence[Injection],
        writers: Mapping[Key, MessageWriter],
        own: Key,
        counts: Counter[str],
        *,
        seed: int,
        keep_counters: bool,
    ) -> None:
        self._writers, self._own = writers, own
        self._counts, self._keep = counts, keep_counters
        self._faults = [
            _Fault(what, random.Random(f"{seed}/{number}"), self._keys(what))
            for number, what in enumerate(injections)
            if what.name in FRAME_FAULTS
        ]
        self._floods: list[_Flood] = []
        self._waiting: list[tuple[int, int, Frame]] = []  # time, order, frame
        self._order = 0
        self._shift: Counter[Key] = Counter()  # what is added to a message's counter

    def _keys(self, what: Injection) -> frozenset[Key] | None:
        if ALL in what.messages:
            return None
        known = {writer.name: key for key, writer in self._writers.items()}
        for name in what.messages:
            if name not in known:
                raise UsageError(
                    f"fault {what.name}: message {name!r} is not in the signal map; "
                    f"there are {', '.join(known)} and all"
                )
        return frozenset(known[name] for name in what.messages) or frozenset({self._own})

    def begin(self, t_ns: int) -> None:
        """Begin a drive whose first frame has this time."""
        self._t0_ns = t_ns
        self._floods = [
            _Flood(each.what, each.random, *each.what.span_ns(t_ns))
            for each in self._faults
            if each.what.name == FLOOD
        ]

    def push(self, frame: Frame, *, sound: bool) -> list[Frame]:
        """Return what goes out at once of a frame.

        sound : its checksum holds, so that its counter may be shifted
        """
        fate = self._fate(frame)
        key = (frame.can_id, frame.is_extended)
        if fate.copies == 0:
            self._counts["lost"] += 1
            self.left_out(key)
            return []
        out = []
        for copy in range(fate.copies):
            self._counts["duplicated"] += copy > 0
            self._shift[key] += self._keep and copy > 0
            out.append(self._changed(frame, self._shift[key] if sound else 0, fate.flipped))
        if not fate.delay_s:
            return out
        self._counts["delayed"] += len(out)
        t_ns = frame.t_ns + round(fate.delay_s * 1e6) * 1000
        for each in out:
            self._wait(each._replace(t_ns=t_ns))
        return []

    def left_out(self, key: Key) -> None:
        """Note that a frame of that message does not go out."""
        self._shift[key] -= self._keep

    def _fate(self, frame: Frame) -> _Fate:
        fate, key = _Fate(), (frame.can_id, frame.is_extended)
        for each in self._faults:
            name, severity = each.what.name, each.what.severity
            is_for_it = each.keys is None or key in each.keys
            if name == FLOOD or not is_for_it or not each.what.acts(frame.t_ns - self._t0_ns):
                continue
            if name == "frame_delay":
                fate.delay_s += severity
            elif each.random.random() >= severity:
                continue
            elif name == "frame_loss":
                fate.copies = 0
            elif name == "frame_duplication":
                fate.copies += fate.copies > 0
            elif frame.data:
                fate.flipped ^= 1 << each.random.randrange(8 * len(frame.data))
        return fate

    def _changed(self, frame: Frame, shift: int, flipped: int) -> Frame:
        data = frame.data
        if shift:
            data = self._writers[frame.can_id, frame.is_extended].write(data, {}, shift)
        if flipped:
            self._counts["corrupted"] += 1
            word = int.from_bytes(data, "little") ^ flipped
            data = word.to_bytes(len(data), "little")
        return frame if data == frame.data else frame._replace(data=data)

    def advance(self, t_ns: float) -> list[Frame]:
        """Return the delayed and flooding frames that are due by then, in the order of time."""
        for flood in self._floods:
            while flood.next_ns <= t_ns and flood.next_ns < flood.end_ns:
                self._counts["flooded"] += 1
                can_id, due_ns = flood.what.can_id, round(flood.next_ns / 1000) * 1000
                self._wait(Frame(due_ns, can_id, can_id > 0x7FF, flood.random.randbytes(8)))
                flood.next_ns += 1e9 / flood.what.severity
        out = []
        while self._waiting and self._waiting[0][0] <= t_ns:
            out.append(heapq.heappop(self._waiting)[2])
        return out

    def flush(self) -> list[Frame]:
        """Return the delayed frames that are left at the end."""
        self._floods.clear()
        return self.advance(math.inf)

    @property
    def due_ns(self) -> float:
        """Return when ``advance`` has something to give, inf if nothing is to come."""
        times = [flood.next_ns for flood in self._floods if flood.next_ns < flood.end_ns]
        if self._waiting:
            times.append(self._waiting[0][0])
        return min(times, default=math.inf)

    def _wait(self, frame: Frame) -> None:
        self._order += 1
        heapq.heappush(self._waiting, (frame.t_ns, self._order, frame))
