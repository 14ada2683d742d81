"""The assembler for whole recordings at once.

Gives the same samples as ``assemble.Assembler``, bit for bit, for frames in the order of time; a
property test holds the two together.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from monitor.assemble import MAX_JUMP_NS, check_grid
from monitor.derived import Output
from monitor.errors import SignalMapError
from monitor.signal_map import Derived
from monitor.types import FloatArray, IntArray, Quality, QualityArray, SampleBlock

Series = tuple[IntArray, FloatArray]  # times and values of one channel, both (n,)


def assemble_arrays(
    frame_times_ns: IntArray,
    series: Sequence[Series],
    channels: Sequence[str],
    names: Sequence[str],
    *,
    period_ns: int,
    timeouts_ns: Sequence[int],
    derived: Sequence[Derived] = (),
) -> SampleBlock:
    """Return all samples of a recording.

    frame_times_ns : (n,) times of all frames, wanted or not, never decreasing
    series : for each channel the times, among those of the frames, and the values; NaN is not
        available, infinite is out of range
    channels, names, period_ns, timeouts_ns, derived : as for ``Assembler``
    Raises SignalMapError if times decrease, or as ``Assembler``.
    """
    check_grid(period_ns)
    if len(series) != len(channels) or len(timeouts_ns) != len(channels):
        raise SignalMapError(f"{len(channels)} channels have {len(series)} series")
    steps_ns = np.diff(frame_times_ns)
    if np.any(steps_ns < 0):
        raise SignalMapError("the times of the frames decrease")
    output = Output(channels, names, derived)
    cuts = [0, *(np.flatnonzero(steps_ns > MAX_JUMP_NS) + 1).tolist(), len(frame_times_ns)]
    blocks: list[SampleBlock] = []
    first = 1
    for number, (begin, end) in enumerate(pairwise(cuts)):
        if begin == end:
            continue
        anchor_ns, last_ns = int(frame_times_ns[begin]), int(frame_times_ns[end - 1])
        if number > 0:
            blocks.append(_break(first, anchor_ns, len(names)))
            first += 1
        n = max(0, (last_ns - anchor_ns - 1) // period_ns)
        n += end < len(frame_times_ns)  # the frame after the jump closes one tick more
        values = np.empty((n, len(channels)))
        quality = np.empty((n, len(channels)), dtype=np.uint8)
        for column, (times_ns, data) in enumerate(series):
            inside = slice(
                np.searchsorted(times_ns, anchor_ns, "left"),
                np.searchsorted(times_ns, last_ns, "right"),
            )
            values[:, column], quality[:, column] = _channel(
                times_ns[inside] - anchor_ns, data[inside], n, period_ns, timeouts_ns[column]
            )
        ticks = np.arange(1, n + 1, dtype=np.int64)
        blocks.append(
            SampleBlock(
                first + ticks - 1,
                anchor_ns + ticks * period_ns,
                *output.of_arrays(values, quality),
            )
        )
        first += n
    return _joined(blocks or [_empty(len(names))])


def _joined(blocks: Sequence[SampleBlock]) -> SampleBlock:
    return SampleBlock(
        np.concatenate([block.index for block in blocks]),
        np.concatenate([block.t_ns for block in blocks]),
        np.concatenate([block.values for block in blocks]),
        np.concatenate([block.quality for block in blocks]),
    )


def _empty(n_names: int) -> SampleBlock:
    none = np.empty(0, dtype=np.int64)
    return SampleBlock(none, none, np.empty((0, n_names)), np.empty((0, n_names), dtype=np.uint8))


def _break(index: int, t_ns: int, n_names: int) -> SampleBlock:
    """Return the all-stale sample that marks a break."""
    return SampleBlock(
        np.array([index], dtype=np.int64),
        np.array([t_ns], dtype=np.int64),
        np.full((1, n_names), np.nan),
        np.full((1, n_names), int(Quality.STALE), dtype=np.uint8),
    )


def _channel(
    times_ns: IntArray, data: FloatArray, n: int, period_ns: int, timeout_ns: int
) -> tuple[FloatArray, QualityArray]:
    """Return one channel on the n ticks of a segment; ``times_ns`` counts from its anchor."""
    tick = np.maximum((times_ns + period_ns - 1) // period_ns, 1) - 1
    inside = tick < n
    tick, times_ns, data = tick[inside], times_ns[inside], data[inside]
    good = np.isfinite(data)
    count = np.bincount(tick[good], minlength=n)
    total = np.bincount(tick[good], weights=data[good], minlength=n)  # sums in order
    quality = np.zeros(n, dtype=np.uint8)
    quality[tick[np.isnan(data)]] = Quality.INVALID
    quality[tick[np.isinf(data)]] = Quality.OUT_OF_RANGE
    quality[count > 0] = Quality.GOOD
    values = np.divide(total, count, out=np.full(n, np.nan), where=count > 0)
    last_ns = np.full(n, -1, dtype=np.int64)
    last_ns[tick] = times_ns  # of several in one tick the last stays
    return _hold(values, quality, last_ns, period_ns, timeout_ns)


def _hold(
    values: FloatArray, quality: QualityArray, last_ns: IntArray, period_ns: int, timeout_ns: int
) -> tuple[FloatArray, QualityArray]:
    """Fill ticks in which nothing came with the last tick's, until it is too old."""
    n = len(values)
    ticks = np.arange(n)
    came = last_ns >= 0
    source = np.maximum.accumulate(np.where(came, ticks, -1))
    values, quality = values[source], quality[source]  # source -1: marked stale below
    age_ns = (ticks + 1) * period_ns - last_ns[source]
    stale = (source < 0) | (~came & (age_ns > timeout_ns))
    values[stale], quality[stale] = np.nan, Quality.STALE
    return values, quality
