"""Many CAN frames side by side."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import Frame, IntArray


@dataclass(frozen=True, slots=True)
class EncodedFrames:
    """Many frames side by side, in the order of time."""

    t_ns: IntArray  # (n,)
    can_id: IntArray  # (n,)
    is_extended: NDArray[np.bool_]  # (n,)
    length: IntArray  # (n,) bytes of each payload
    data: NDArray[np.uint8]  # (n, 8), zeros behind the payload

    def frames(self) -> Iterator[Frame]:
        """Yield them one by one."""
        for t_ns, can_id, extended, length, data in zip(
            self.t_ns.tolist(),
            self.can_id.tolist(),
            self.is_extended.tolist(),
            self.length.tolist(),
            self.data,
            strict=True,
        ):
            yield Frame(t_ns, can_id, extended, data[:length].tobytes())
