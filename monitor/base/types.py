"""The values that pass through the monitor, in the order of the data."""

from collections.abc import Mapping
from enum import IntEnum
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
QualityArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]


class Shown:
    """A result that says what is in it: in one line, in a notebook as a table."""

    __slots__ = ()

    @property
    def facts(self) -> Mapping[str, object]:
        """Return what is in it, by name, in words and numbers."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """Return the facts on one line."""
        return f"<{type(self).__name__} {', '.join(f'{k}: {v}' for k, v in self.facts.items())}>"

    def _repr_html_(self) -> str:
        cells = ((escape(str(key)), escape(str(value))) for key, value in self.facts.items())
        rows = "".join(f"<tr><th>{key}</th><td>{value}</td></tr>" for key, value in cells)
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


class Frame(NamedTuple):
    """One CAN frame. It is a tuple for speed: the monitor makes one for every frame on the bus."""

    t_ns: int  # time since the epoch, or since the start of the log
    can_id: int  # 11-bit or 29-bit identifier, without flags
    is_extended: bool
    data: bytes


class FrameBlock(NamedTuple):
    """Many CAN frames side by side, in the order of the log; row i is one ``Frame``."""

    t_ns: IntArray  # (n,)
    key: NDArray[np.uint32]  # (n,) identifier; bit 31 is set if it has 29 bits
    length: NDArray[np.uint8]  # (n,) bytes of data
    data: NDArray[np.uint8]  # (n, 8), or (n, 64) if a frame is longer; zero after a frame's end


class Quality(IntEnum):
    """Quality of one value of a sample; the value is NaN unless the quality is GOOD or PINNED."""

    GOOD = 0
    STALE = 1  # not received for longer than the signal's timeout
    INVALID = 2  # the sender marks it as not available
    OUT_OF_RANGE = 3  # outside the plausible range
    OFF_BUS = 4  # not received for that long while the monitor itself was off the bus
    PINNED = 5  # the logger's value for "no sensor" or the end of its range; the value is kept
    GAP = 6  # not received since a pause of the whole log, of which nothing is known


class Sample(NamedTuple):
    """All signals on one tick of the sample grid."""

    index: int  # type: ignore[assignment]  # tuple.index is not used; tick number k, t_ns = t0 + k * period
    t_ns: int
    values: FloatArray  # (n_signals,) in the order of the assembler's names; NaN if not GOOD
    quality: QualityArray  # (n_signals,) one Quality per value


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
