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
        if channel.signal.is_float:
            self._low, self._high = plausible_range(channel)
        else:
            self._bottom, self._top = plausible_raw(channel)

    def read(self, payloads: Payloads, out: FloatArray) -> tuple[int, int]:
        """Fill ``out``, (n,), NaN where not available and inf where out of range.

        Returns how many are not available and how many out of range.
        """
        raw = payloads.raw(self._signal)
        out[:] = self._scaled(raw.astype(np.float64))
        if self._signal.is_float:
            good = np.isfinite(out) & (self._low <= out) & (out <= self._high)
            missing = np.zeros(len(out), dtype=np.bool_)
        else:
            good = np.asarray((raw >= self._bottom) & (raw <= self._top), dtype=np.bool_)
            if good.all():
                return 0, 0
            missing = ~good & np.asarray(raw == self._missing, dtype=np.bool_)
        out[~good] = np.inf
        out[missing] = np.nan
        n_missing = int(np.count_nonzero(missing))
        return n_missing, int(np.count_nonzero(~good)) - n_missing
