"""Faults of frames: loss, duplication, corruption, delay, and a flood of other frames."""

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
class _Fault:
    """A fault of the frames under some identifiers, or a flood."""

    what: Injection
    random: random.Random
    keys: frozenset[Key] | None  # None: of all frames
    next_ns: float = math.inf  # time of a flood's next frame


@dataclass(slots=True)
class _Fate:
    """The changes to one frame."""

    copies: int = 1
    flipped: int = 0  # mask of flipped bits; bit 0 is the lowest of the first byte
    delay_s: float = 0.0


class FrameFaults:
    """Takes the frames one by one; returns the outgoing ones at once or when they are due.

    writers : writers of the messages that a fault may name
    own : identifier of the message that a fault without message names acts on
    counts : counts of changed frames, updated here
    keep_counters : renumber alive counters, so that lost or doubled frames leave no gap
    Raises UsageError if a fault names an unknown message.
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
        every = [
            _Fault(what, random.Random(f"{seed}/{number}"), self._keys(what))
            for number, what in enumerate(injections)
            if what.name in FRAME_FAULTS
        ]
        self._floods = [fault for fault in every if fault.what.name == FLOOD]
        self._faults = [fault for fault in every if fault.what.name != FLOOD]
        self._t0_ns = 0
        self._waiting: list[tuple[int, int, Frame]] = []  # time, order, frame
        self._order = 0
        self._shift: Counter[Key] = Counter()  # offset added to a message's alive counter

    def _keys(self, what: Injection) -> frozenset[Key] | None:
        if ALL in what.messages:
            return None
        keys = {writer.name: key for key, writer in self._writers.items()}
        for name in what.messages:
            if name not in keys:
                raise UsageError(
                    f"fault {what.name}: message {name!r} is not in the signal map; "
                    f"there are {', '.join(keys)} and all"
                )
        return frozenset(keys[name] for name in what.messages) or frozenset({self._own})

    def begin(self, t_ns: int) -> None:
        """Begin a drive whose first frame comes at ``t_ns``."""
        self._t0_ns = t_ns
        for flood in self._floods:
            flood.next_ns = t_ns + math.ceil(flood.what.start_s * 1e9)

    def push(self, frame: Frame, key: Key, *, sound: bool) -> list[Frame]:
        """Return the frames that go out at once for one incoming frame.

        key : of its message
        sound : its checksum is right, so its alive counter may be shifted
        """
        if not self._faults and not self._shift[key]:
            return [frame]
        fate = self._fate(frame, key)
        if fate.copies == 0:
            self._counts["lost"] += 1
            self.left_out(key)
            return []
        out = []
        for copy in range(fate.copies):
            self._counts["duplicated"] += copy > 0
            self._shift[key] += self._keep and copy > 0
            shift = self._shift[key] if sound else 0
            data = self._writers[key].write(frame.data, {}, shift) if shift else frame.data
            out.append(self._flipped(frame._replace(data=data), fate.flipped))
        if not fate.delay_s:
            return out
        self._counts["delayed"] += len(out)
        t_ns = frame.t_ns + round(fate.delay_s * 1e6) * 1000
        for late in out:
            self._wait(late._replace(t_ns=t_ns))
        return []

    def left_out(self, key: Key) -> None:
        """Record that a frame of a message does not go out."""
        self._shift[key] -= self._keep

    def _fate(self, frame: Frame, key: Key) -> _Fate:
        fate = _Fate()
        for fault in self._faults:
            name, severity = fault.what.name, fault.what.severity
            concerns = fault.keys is None or key in fault.keys
            if not concerns or not fault.what.acts(frame.t_ns - self._t0_ns):
                continue
            if name == "frame_delay":
                fate.delay_s += severity
            elif fault.random.random() >= severity:
                continue
            elif name == "frame_loss":
                fate.copies = 0
            elif name == "frame_duplication":
                fate.copies += fate.copies > 0
            elif frame.data:
                fate.flipped ^= 1 << fault.random.randrange(8 * len(frame.data))
        return fate

    def _flipped(self, frame: Frame, flipped: int) -> Frame:
        if not flipped:
            return frame
        self._counts["corrupted"] += 1
        word = int.from_bytes(frame.data, "little") ^ flipped
        return frame._replace(data=word.to_bytes(len(frame.data), "little"))

    def advance(self, t_ns: float) -> list[Frame]:
        """Return the delayed and flooding frames due by ``t_ns``, in order of time."""
        for flood in self._floods:
            while flood.next_ns <= t_ns and self._goes_on(flood):
                self._counts["flooded"] += 1
                can_id, due_ns = flood.what.can_id, round(flood.next_ns / 1000) * 1000
                self._wait(Frame(due_ns, can_id, can_id > 0x7FF, flood.random.randbytes(8)))
                flood.next_ns += round(1e9 / flood.what.severity)
        out = []
        while self._waiting and self._waiting[0][0] <= t_ns:
            out.append(heapq.heappop(self._waiting)[2])
        return out

    def flush(self) -> list[Frame]:
        """Return the remaining delayed frames at the end of a drive."""
        self._floods.clear()
        return self.advance(math.inf)

    @property
    def due_ns(self) -> float:
        """Return the time in ns of the next due frame, inf if there is none."""
        times = [flood.next_ns for flood in self._floods if self._goes_on(flood)]
        times += [t_ns for t_ns, _, _ in self._waiting[:1]]
        return min(times, default=math.inf)

    def _goes_on(self, flood: _Fault) -> bool:
        return flood.what.acts(flood.next_ns - self._t0_ns)

    def _wait(self, frame: Frame) -> None:
        self._order += 1
        heapq.heappush(self._waiting, (frame.t_ns, self._order, frame))
