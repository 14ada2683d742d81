"""Raw values of one channel to values in the map's unit."""

import numpy as np

from monitor.base.types import FloatArray
from monitor.decode.bus_map import BusChannel
from monitor.decode.payloads import Payloads
from monitor.decode.raw_values import not_available_raw, plausible_range, scaling


class ChannelReader:
    """Reads one channel of a message's payloads."""

    def __init__(self, channel: BusChannel) -> None:
        self._signal, self._scaled = channel.signal, scaling(channel)
        self._missing = not_available_raw(channel)
        self.range = channel.range
        self._low, self._high = plausible_range(channel)

    def read(
        self, payloads: Payloads, out: FloatArray, most: FloatArray | None = None
    ) -> tuple[int, int]:
        """Fill ``out``, (n,), NaN where not available and inf where out of range.

        most : (n,) highest value in the database's unit, 0 where it is the database's
        Returns how many are not available and how many out of range.
        """
        raw = payloads.raw(self._signal)
        number = raw.astype(np.float64)
        if most is not None:
            number *= np.where(most > 0.0, most / float(self._signal.maximum or 1.0), 1.0)
        out[:] = self._scaled(number)
        good = (self._low <= out) & (out <= self._high) & np.isfinite(out)
        n_missing = 0
        if self._missing is not None:
            missing = np.asarray(raw == self._missing, dtype=np.bool_)
            n_missing = int(np.count_nonzero(missing))
            good &= ~missing
        n_bad = len(out) - int(np.count_nonzero(good))
        if n_bad:
            out[~good] = np.inf
        if n_missing:
            out[missing] = np.nan
        return n_missing, n_bad - n_missing
