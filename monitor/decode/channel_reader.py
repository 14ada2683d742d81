"""Raw values of one channel to values in the map's unit."""

import numpy as np

from monitor.base.types import FloatArray
from monitor.decode.bus_map import BusChannel
from monitor.decode.payloads import Payloads
from monitor.decode.raw_values import not_available_raw, plausible_range, plausible_raw, scaling


class ChannelReader:
    """Reads one channel of a message's payloads."""

    def __init__(self, channel: BusChannel) -> None:
        self._signal, self._scaled = channel.signal, scaling(channel)
        self._missing = not_available_raw(channel)
        self.range = channel.range
        self._low, self._high = plausible_range(channel)
        if not channel.signal.is_float:
            self._bottom, self._top = plausible_raw(channel)

    def read(
        self, payloads: Payloads, out: FloatArray, most: FloatArray | None = None
    ) -> tuple[int, int]:
        """Fill ``out``, (n,), NaN where not available and inf where out of range.

        most : (n,) highest value in the database's unit, 0 where it is the database's
        Returns how many are not available and how many out of range.
        """
        raw = payloads.raw(self._signal)
        by_range = most is not None and bool(most.any())
        number = raw.astype(np.float64)
        if most is not None and by_range:
            number *= np.where(most > 0.0, most / float(self._signal.maximum or 1.0), 1.0)
        out[:] = self._scaled(number)
        if self._signal.is_float or by_range:
            good = np.isfinite(out) & (self._low <= out) & (out <= self._high)
        else:
            good = np.asarray((raw >= self._bottom) & (raw <= self._top), dtype=np.bool_)
            if good.all():
                return 0, 0
        missing = np.asarray(raw == self._missing, dtype=np.bool_)
        good &= ~missing
        out[~good] = np.inf
        out[missing] = np.nan
        n_missing = int(np.count_nonzero(missing))
        return n_missing, int(np.count_nonzero(~good)) - n_missing
