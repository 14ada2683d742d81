"""Values that travel through the monitor, in the order in which they are made."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
QualityArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]

# What one frame says: channel numbers, and as many values in canonical units; NaN stands for not
# available, +inf for out of range.
Update = tuple[tuple[int, ...], tuple[float, ...]]


class Frame(NamedTuple):
    """One CAN frame. A tuple, because one is made for every frame on the bus."""

    t_ns: int  # time since the epoch or since the log's zero
    can_id: int  # 11 or 29 bit identifier, without flags
    is_extended: bool
    data: bytes


class FrameBlock(NamedTuple):
    """Many CAN frames side by side, in the order of the log; row i is one Frame."""

    t_ns: IntArray  # (n,)
    key: NDArray[np.uint32]  # (n,) identifier, with bit 31 set if it has 29 bits
    length: NDArray[np.uint8]  # (n,) bytes of data
    data: NDArray[np.uint8]  # (n, 8), or (n, 64) if one is longer; zero behind each frame's end


class Quality(IntEnum):
    """How good one value of a sample is; anything but GOOD comes with the value NaN."""

    GOOD = 0
    STALE = 1  # nothing received for longer than the signal's timeout
    INVALID = 2  # the sender says: not available
    OUT_OF_RANGE = 3  # outside the plausible range
    OFF_BUS = 4  # nothing received for as long, but the monitor itself was off the bus


class Sample(NamedTuple):
    """All signals on one tick of the sample grid."""

    index: int  # type: ignore[assignment]  # tuple.index is not used; tick number k, t_ns = t0 + k * period
    t_ns: int
    values: FloatArray  # (n_signals,) in the order of the assembler's names; NaN if not GOOD
    quality: QualityArray  # (n_signals,) a Quality for each value


class SampleBlock(NamedTuple):
    """Samples of a recording side by side; row i is one Sample."""

    index: IntArray  # type: ignore[assignment]  # (n,)
    t_ns: IntArray  # (n,)
    values: FloatArray  # (n, n_signals)
    quality: QualityArray  # (n, n_signals)

    def part(self, begin: int, end: int) -> "SampleBlock":
        """Return the samples from begin to end; they share the block's memory."""
        inside = slice(begin, end)
        return SampleBlock(
            self.index[inside], self.t_ns[inside], self.values[inside], self.quality[inside]
        )
