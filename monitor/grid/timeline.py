"""Times of a log's frames to times that are believed.

A frame in time passes as it is. A frame far from the newest time is one of these:

outlier    most frames behind it disagree with its time: it gets the newest time
clock step the clock of the log was set, back or forward: all later times are moved so that they
           go on; forward only if alive counters say that no frame was missed
silence    alive counters say that frames were missed, or the message came on its own usual time:
           time has passed and is believed
log gap    no counter tells, or other frames of the log have times within the pause, so that its
           order is broken, not the bus: the time is believed, a ``log_gap`` frame before it ends
           all windows

Times of the loop's own frames are always believed: the loop has measured them. No result depends
on where blocks begin.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from monitor.base.types import FrameBlock, IntArray
from monitor.decode.alive import AliveCounters
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import EXTENDED, chosen, joined
from monitor.frames.loop_frames import FIRST_ID, LOG_GAP_ID
from monitor.grid.assembler import LATEST_NS

WITNESSES: Final = 32  # frames behind a doubtful one that confirm its time or not
LOOK: Final = 8192  # frames before and behind a pause in which counters are looked for
_WALK: Final = 2048  # frames taken one by one from a doubtful one on
_USUAL: Final = 5  # latest frames of a message that tell its usual interval


@dataclass(slots=True)
class TimeCounters:
    """What was not believed of the frames' times."""

    clock_steps: int = 0  # the clock was set, back or forward
    log_gaps: int = 0  # pauses of the whole log of which nothing is known
    outliers: int = 0  # single frames whose time the others contradict

    @property
    def found(self) -> dict[str, int]:
        """Return the counters that are not 0."""
        return {name: count for name, count in asdict(self).items() if count}


class Timeline:
    """Turns the times of a log's frames into believed times.

    decoder : of the log; its messages' counters are read, its state is left alone
    """

    def __init__(self, decoder: BlockDecoder) -> None:
        self.counters = TimeCounters()
        self._decoder = decoder
        self._pause_ns = min(decoder.timeouts_ns)  # no value goes stale in a shorter pause
        self._newest_ns: int | None = None  # of the believed times
        self._shift_ns = 0  # believed time is the frame's time less this
        self._recent = _Recent()
        self._waiting: FrameBlock | None = None  # frames that need those behind them

    def blocks(self, blocks: Iterable[FrameBlock]) -> Iterator[FrameBlock]:
        """Yield the frames of a log at believed times, with the ``log_gap`` frames among them."""
        for block in blocks:
            yield from self.push(block)
        yield from self.finish()

    def push(self, block: FrameBlock) -> Sequence[FrameBlock]:
        """Take the next frames; return those whose times are decided."""
        if len(block.t_ns) == 0:
            return ()
        if self._newest_ns is None:
            self._newest_ns = int(block.t_ns[0])
        if self._waiting is None and self._is_calm(block.t_ns):
            if self._shift_ns:
                block = block._replace(t_ns=block.t_ns - _wrapped(self._shift_ns))
            self._newest_ns = int(block.t_ns[-1])
            self._recent.push(block, block.t_ns + _wrapped(self._shift_ns))
            return (block,)
        waiting = [] if self._waiting is None else [self._waiting]
        return self._walked(joined([*waiting, block]), is_last=False)

    def finish(self) -> Sequence[FrameBlock]:
        """Return the frames that waited for others behind them; none will come."""
        return () if self._waiting is None else self._walked(self._waiting, is_last=True)

    def _is_calm(self, raw_ns: IntArray) -> bool:
        """Return whether times rise by small steps, (n,) at least one."""
        assert self._newest_ns is not None
        first_ns = int(raw_ns[0]) - self._shift_ns - self._newest_ns
        steps_ns = raw_ns[1:] - raw_ns[:-1]
        least_ns, most_ns = int(steps_ns.min(initial=0)), int(steps_ns.max(initial=0))
        return min(first_ns, least_ns) >= 0 and max(first_ns, most_ns) <= self._pause_ns

    def _walked(self, frames: FrameBlock, *, is_last: bool) -> Sequence[FrameBlock]:
        """Return frames of which some are doubtful, as far as enough frames follow.

        is_last : no frame follows
        """
        assert self._newest_ns is not None
        walk = _Walk(self._recent, frames, self._newest_ns, self._shift_ns, self._pause_ns)
        walk.run(self._decoder, self.counters, is_last=is_last)
        self._newest_ns, self._shift_ns = walk.newest_ns, walk.shift_ns
        n = walk.at
        self._waiting = chosen(frames, slice(n, None)) if n < len(frames.t_ns) else None
        if n == 0:
            return ()
        believed = chosen(frames, slice(0, n))._replace(t_ns=walk.believed_ns(n))
        self._recent.push(believed, frames.t_ns[:n])
        return (_with_gaps(believed, walk.gaps),)


class _Recent:
    """The latest frames of a log, at least ``LOOK`` of them if so many came."""

    def __init__(self) -> None:
        self._blocks: deque[FrameBlock] = deque()
        self._raw_ns: deque[IntArray] = deque()  # of each block, as the log has them
        self._n = 0

    def push(self, block: FrameBlock, raw_ns: IntArray) -> None:
        """Take the next frames and their times in the log; forget those of long ago."""
        self._blocks.append(block)
        self._raw_ns.append(raw_ns)
        self._n += len(block.t_ns)
        while self._n - len(self._blocks[0].t_ns) >= LOOK:
            self._n -= len(self._blocks.popleft().t_ns)
            self._raw_ns.popleft()

    def before(self, frames: FrameBlock) -> tuple[FrameBlock, IntArray, int]:
        """Return the latest frames and those that follow as one block.

        Also return all their times in the log, and how many frames are before.
        """
        raw_ns = frames.t_ns
        if self._n:
            latest, latest_ns = joined(list(self._blocks)), np.concatenate(self._raw_ns)
            self._blocks, self._raw_ns = deque([latest]), deque([latest_ns])
            frames, raw_ns = joined([latest, frames]), np.concatenate([latest_ns, raw_ns])
        return frames, raw_ns, self._n


class _Walk:
    """Some frames of a log on their way to believed times.

    at : frames that have one
    gaps : places of the frames before which nothing is known of the time
    """

    def __init__(
        self, recent: _Recent, frames: FrameBlock, newest_ns: int, shift_ns: int, pause_ns: int
    ) -> None:
        self.newest_ns, self.shift_ns, self._pause_ns = newest_ns, shift_ns, pause_ns
        self.at, self.gaps = 0, list[int]()
        whole, self._whole_raw_ns, self._n_before = recent.before(frames)
        self._t_ns = whole.t_ns.copy()  # believed where the walk has been
        self._whole = whole._replace(t_ns=self._t_ns)
        self._alive: AliveCounters | None = None  # read when they are needed
        self._raw_ns = frames.t_ns
        self._is_own = (frames.key & EXTENDED > 0) & (frames.key & (EXTENDED - 1) >= FIRST_ID)

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
                elif is_last or n - self.at >= LOOK:
                    self._decide(t_ns, decoder, counters)
                else:
                    return
                self.at += 1

    def _run_calm(self) -> None:
        """Accept the frames before the first doubtful one."""
        t_ns = self._raw_ns[self.at :] - _wrapped(self.shift_ns)
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
        later_ns = self._raw_ns[self.at + 1 : self.at + 1 + WITNESSES] - _wrapped(self.shift_ns)
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
        if verdict == "missed" and is_forward and self._is_filled(at, t_ns):
            verdict = "unknown"
        is_step = verdict == "went on" or not is_forward or t_ns >= LATEST_NS
        counters.clock_steps += is_step
        if verdict != "went on" and (is_step or verdict == "unknown"):
            self.gaps.append(self.at)
            counters.log_gaps += not is_step
        if is_step:
            self.shift_ns += t_ns - self.newest_ns
            t_ns = self.newest_ns
        self._accept(t_ns)

    def _is_filled(self, at: int, t_ns: int) -> bool:
        """Return whether frames before or behind have times within the pause that ends at t_ns.

        at : place of the frame that ends the pause
        """
        around_ns = self._whole_raw_ns[max(at - LOOK, 0) : at + LOOK] - _wrapped(self.shift_ns)
        return bool(np.any((around_ns > self.newest_ns) & (around_ns < t_ns)))

    def _comes_on_time(self, t_ns: int) -> bool:
        """Return whether a frame comes after its message's usual interval, whatever else paused."""
        at = self._n_before + self.at
        begin = max(at - LOOK, 0)
        key = self._whole.key
        places = begin + np.flatnonzero(key[begin:at] == key[at])[-_USUAL:]
        if len(places) < _USUAL:
            return False
        intervals_ns = np.diff(self._t_ns[places])
        is_regular = int(intervals_ns.max() - intervals_ns.min()) <= self._pause_ns
        late_ns = t_ns - int(self._t_ns[places[-1]]) - int(np.median(intervals_ns))
        return is_regular and late_ns <= self._pause_ns


def _with_gaps(block: FrameBlock, gaps: Sequence[int]) -> FrameBlock:
    """Return frames with a ``log_gap`` frame before each of the places."""
    if not gaps:
        return block
    key = np.uint32(LOG_GAP_ID | EXTENDED)
    return FrameBlock(
        np.insert(block.t_ns, gaps, block.t_ns[list(gaps)]),
        np.insert(block.key, gaps, key),
        np.insert(block.length, gaps, 0),
        np.insert(block.data, gaps, 0, axis=0),
    )


def _wrapped(t_ns: int) -> np.int64:
    """Return a time as numpy reckons with it, modulo 2**64."""
    return np.int64((t_ns + (1 << 63)) % (1 << 64) - (1 << 63))
