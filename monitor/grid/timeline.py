"""Times of a log's frames to times that are believed.

A frame in time passes as it is. A frame far from the newest time is one of these:

outlier    most frames behind it disagree with its time: it gets the newest time
clock step the clock of the log was set, back or forward: all later times are moved so that they
           go on; forward only if alive counters say that no frame was missed
silence    the message came on its own usual time, so the log was awake; or alive counters say that
           frames were missed for more than a minute: time has passed and is believed
log gap    nobody was heard, and the logger may have slept as well as the bus: the time is believed,
           a ``log_gap`` frame before it ends all windows

Times of the loop's own frames are always believed: the loop has measured them. No result depends
on where blocks begin.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence

from monitor.base.types import FrameBlock, IntArray
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import block_of, chosen, inserted, joined
from monitor.frames.loop_frames import log_gap
from monitor.grid.time_walk import KEPT, TimeCounters, Walk, wrapped


class Timeline:
    """Turns the times of a log's frames into believed times.

    decoder : of the log; its messages' counters are read, its state is left alone
    """

    def __init__(self, decoder: BlockDecoder) -> None:
        self.counters = TimeCounters()
        self._decoder = decoder
        self._pause_ns = min(decoder.timeouts_ns)  # no value goes stale in a shorter pause
        self._newest_ns: int | None = None  # of the believed times
        self._first_ns = 0
        self._shift_ns = 0  # believed time is the frame's time less this
        self._recent = deque([block_of([])])  # the latest frames, ``KEPT`` of them if so many came
        self._waiting: FrameBlock | None = None  # frames that need those behind them

    def blocks(self, blocks: Iterable[FrameBlock]) -> Iterator[FrameBlock]:
        """Yield the frames of a log at believed times, with the ``log_gap`` frames among them."""
        for block in blocks:
            yield from self.push(block)
        yield from self.finish()

    @property
    def notes(self) -> tuple[str, ...]:
        """Return in words that a log's times step all the time, for half of it at least."""
        steps = self.counters.clock_steps + self.counters.log_gaps
        if not steps or 2 * steps * self._pause_ns <= (self._newest_ns or 0) - self._first_ns:
            return ()
        return (
            f"its times step {steps} times: frames written in batches; log the times at which "
            "they are received",
        )

    def push(self, block: FrameBlock) -> Sequence[FrameBlock]:
        """Take the next frames; return those whose times are decided."""
        if len(block.t_ns) == 0:
            return ()
        if self._newest_ns is None:
            self._newest_ns = self._first_ns = int(block.t_ns[0])
        if self._waiting is None and self._is_calm(block.t_ns):
            if self._shift_ns:
                block = block._replace(t_ns=block.t_ns - wrapped(self._shift_ns))
            self._newest_ns = int(block.t_ns[-1])
            self._note(block)
            return (block,)
        waiting = [] if self._waiting is None else [self._waiting]
        return self._walked(joined([*waiting, block]), is_last=False)

    def finish(self) -> Sequence[FrameBlock]:
        """Return the frames that waited for others behind them; none will come."""
        return () if self._waiting is None else self._walked(self._waiting, is_last=True)

    def _note(self, block: FrameBlock) -> None:
        """Take frames at believed times as the latest; forget those of long ago."""
        self._recent.append(block)
        n = sum(len(each.t_ns) for each in self._recent)
        while n - len(self._recent[0].t_ns) >= KEPT:
            n -= len(self._recent.popleft().t_ns)

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
        self._recent = deque([joined(list(self._recent))])
        walk = Walk(self._recent[0], frames, self._newest_ns, self._shift_ns, self._pause_ns)
        walk.run(self._decoder, self.counters, is_last=is_last)
        self._newest_ns, self._shift_ns = walk.newest_ns, walk.shift_ns
        n = walk.at
        self._waiting = chosen(frames, slice(n, None)) if n < len(frames.t_ns) else None
        if n == 0:
            return ()
        believed = chosen(frames, slice(0, n))._replace(t_ns=walk.believed_ns(n))
        self._note(believed)
        marks = [log_gap(int(believed.t_ns[place])) for place in walk.gaps]
        return (inserted(believed, walk.gaps, block_of(marks)),) if marks else (believed,)
