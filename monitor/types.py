"""Values that travel through the monitor, in the order in which they are made."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Frame(NamedTuple):
    """One CAN frame. A tuple, because one is made for every frame on the bus."""

    t_ns: int  # time since the epoch or since the log's zero
    can_id: int  # 11 or 29 bit identifier, without flags
    is_extended: bool
    data: bytes


class Sample(NamedTuple):
    """All signals on one tick of the sample grid."""

    index: int  # tick number k, t_ns = t0 + k * period
    t_ns: int
    values: FloatArray  # (n_signals,) in the order of the assembler's names; NaN if not valid
