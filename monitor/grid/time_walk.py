"""Frames of a log whose times are in doubt, on their way to believed times, one after the other."""

from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from monitor.base.types import FrameBlock, IntArray
from monitor.decode.alive import AliveCounters
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import EXTENDED, joined
from monitor.frames.loop_frames import FIRST_ID
from monitor.grid.block_assembler import LATEST_NS, MAX_JUMP_NS

KEPT: Final = 1 << 16  # 16 s of a full bus of 500 kbit/s; stretches of a log may be out of order
WITNESSES: Final = 32  # frames behind a doubtful one that confirm its time or not
LOOK: Final = 8192  # frames before and behind a pause in which counters are looked for
_WALK: Final = 2048  # frames taken one by one from a doubtful one on
_USUAL: Final = 5  # latest frames of a message that tell its usual interval


@dataclass(slots=True)
class TimeCounters:
    """Counts of the frames' times that were not believed."""

    clock_steps: int = 0  # the clock was set, back or forward
    log_gaps: int = 0  # pauses of the whole log of which nothing is known
    outliers: int = 0  # single frames whose time the others contradict

    @property
    def found(self) -> dict[str, int]:
        """Return the counters that are not 0."""
        return {name: count for name, count in asdict(self).items() if count}


class Walk:
    """Some frames of a log on their way to believed times.

    recent : the latest frames before them, at believed times
    at : frames that have one
    gaps : places of the frames before which nothing is known of the time
    """

    def __init__(
        self, recent: FrameBlock, frames: FrameBlock, newest_ns: int, shift_ns: int, pause_ns: int
    ) -> None:
        self.newest_ns, self.shift_ns, self._pause_ns = newest_ns, shift_ns, pause_ns
        self.at, self.gaps = 0, list[int]()
        whole, self._n_before = joined([recent, frames]), len(recent.t_ns)
        self._t_ns = whole.t_ns.copy()  # believed where the walk has been
        self._whole = whole._replace(t_ns=self._t_ns)
        self._alive: AliveCounters | None = None  # read when they are needed
        self._raw_ns = frames.t_ns
        self._is_own = frames.key >= FIRST_ID | EXTENDED

    def believed_ns(self, n: int) -> IntArray:
        """Return the believed times of the first frames, (n,)."""
        return self._t_ns[self._n_before : self._n_before + n]

    def run(self, decoder: BlockDecoder, counters: TimeCounters, *, is_last: bool) -> None:
        """Walk on until a doubtful frame has too few frames behind it, or to the end."""
        n = len(self._raw_ns)
        while self.at < n:
            self._run_calm()
            end = min(self.at + _WALK, n)
            own = self._is_own[self.at : end].tolist()
            for raw_ns, is_own in zip(self._raw_ns[self.at : end].tolist(), own, strict=True):
                t_ns = raw_ns - self.shift_ns
                if not self._is_doubtful(t_ns, is_own=is_own):
                    self._accept(t_ns)
                elif is_last or n - self.at >= KEPT:
                    self._decide(t_ns, decoder, counters)
                else:
                    return
                self.at += 1

    def _run_calm(self) -> None:
        """Accept the frames before the first doubtful one."""
        t_ns = self._raw_ns[self.at :] - wrapped(self.shift_ns)
        newest_ns = np.maximum.accumulate(np.concatenate([[self.newest_ns], t_ns]))
        doubtful = np.abs(t_ns - newest_ns[:-1]) > self._pause_ns
        n = int(doubtful.argmax()) if doubtful.any() else len(t_ns)
        self._t_ns[self._n_before + self.at :][:n] = t_ns[:n]
        self.newest_ns = int(newest_ns[n])
        self.at += n

    def _is_doubtful(self, t_ns: int, *, is_own: bool) -> bool:
        if is_own:
            return abs(t_ns) >= LATEST_NS
        return not -self._pause_ns <= t_ns - self.newest_ns <= self._pause_ns

    def _accept(self, t_ns: int) -> None:
        self._t_ns[self._n_before + self.at] = t_ns
        self.newest_ns = max(self.newest_ns, t_ns)

    def _decide(self, t_ns: int, decoder: BlockDecoder, counters: TimeCounters) -> None:
        """Give the doubtful frame a believed time; it would be at ``t_ns``."""
        later_ns = self._raw_ns[self.at + 1 : self.at + 1 + WITNESSES] - wrapped(self.shift_ns)
        is_forward = t_ns > self.newest_ns
        edge_ns = (t_ns if is_forward else self.newest_ns) - self._pause_ns
        n_below = int(np.count_nonzero(later_ns < edge_ns))
        is_alone = 2 * n_below > len(later_ns) if is_forward else 2 * n_below <= len(later_ns)
        if is_forward and not is_alone and self._comes_on_time(t_ns):
            self._accept(t_ns)
            return
        if is_alone or len(later_ns) == 0:
            counters.outliers += 1
            self._accept(self.newest_ns)
            return
        at = self._n_before + self.at
        self._alive = self._alive or AliveCounters(decoder, self._whole)
        verdict = self._alive.verdict(
            begin=max(at - LOOK, 0),
            at=at,
            end=at + LOOK,
            pause_ns=t_ns - self.newest_ns if is_forward else None,
        )
        is_step = verdict == "went on" or not is_forward or t_ns >= LATEST_NS
        counters.clock_steps += is_step
        is_silence = not is_step and verdict == "missed" and t_ns - self.newest_ns > MAX_JUMP_NS
        if verdict != "went on" and not is_silence:
            self.gaps.append(self.at)  # nobody was heard: the logger may have slept, or the bus
            counters.log_gaps += not is_step
        if is_step:
            self.shift_ns += t_ns - self.newest_ns
            t_ns = self.newest_ns
        self._accept(t_ns)

    def _comes_on_time(self, t_ns: int) -> bool:
        """Return whether a frame is on time while others, which used to come between, do not.

        It comes after its message's usual interval, and at most half as many frames came since the
        one before as between two of them when the bus was alive.
        """
        at = self._n_before + self.at
        begin = max(at - LOOK, 0)
        key = self._whole.key
        places = begin + np.flatnonzero(key[begin:at] == key[at])
        if len(places) < _USUAL or 2 * (at - int(places[-1])) > int(np.diff(places).max()):
            return False
        intervals_ns = np.diff(self._t_ns[places[-_USUAL:]])
        is_regular = int(intervals_ns.max() - intervals_ns.min()) <= self._pause_ns
        late_ns = t_ns - int(self._t_ns[places[-1]]) - int(np.median(intervals_ns))
        return is_regular and late_ns <= self._pause_ns


def wrapped(t_ns: int) -> np.int64:
    """Return a time as numpy reckons with it, modulo 2**64."""
    return np.int64((t_ns + (1 << 63)) % (1 << 64) - (1 << 63))
