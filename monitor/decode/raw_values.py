"""Raw values of a DBC signal: their place, their meaning, their plausible range."""

import math
import re
from typing import TYPE_CHECKING, Final

from cantools.database.can import Message, Signal

from monitor.base import signals

if TYPE_CHECKING:
    from monitor.decode.bus_map import BusChannel

_STATES_FROM: Final = 2  # bits
_QUANTITY_FROM: Final = 6
_INVALID: Final = re.compile(
    "^(?:sna|na|init)$|invalid|unavailable|notavail|notvalid|notready|nosignal|"
    "(?<!de|no)(?:error|fault|failure|defe[ck]t)|fehler|ung(?:ü|ue)ltig|nichtverf|reserv|undefin"
)
_J1939_STATES: Final = {2: 2, 4: 2, 8: 5}  # of so many bits, the highest


def not_available_raw(channel: "BusChannel") -> int | None:
    """Return the raw value that says not available, None if the signal has none."""
    signal = channel.signal
    if not channel.integrity.not_available or signal.length < 2 or signal.is_float:
        return None
    return int(-(1 << (signal.length - 1)) if signal.is_signed else (1 << signal.length) - 1)


def raw_limits(channel: "BusChannel") -> tuple[int, int]:
    """Return the least and the most raw value that is a value, of integers.

    Behind them stand states: that the value is not available, those that the database names there
    (``VAL_ … 254 "Error" 255 "SNA"``), and those of J1939 (J1939-71, table 1).
    """
    signal, missing = channel.signal, not_available_raw(channel)
    least = -(1 << (signal.length - 1)) if signal.is_signed else 0
    low, high = least, least + (1 << signal.length) - 1
    if channel.message.protocol == "j1939" or channel.any_source:
        n_bits = min(signal.length, 8)
        high -= (1 << (signal.length - n_bits)) * _J1939_STATES.get(n_bits, 0) * (least == 0)
    named = {int(value) for value in signal.choices or {}}
    while high in named:
        high -= 1
    while signal.is_signed and low in named:
        low += 1
    if signal.length < _STATES_FROM or low >= high:  # all, or all but one, are named: states alone
        low, high = least, least + (1 << signal.length) - 1
    return low + (low == missing), high - (high == missing)


def states_of(channel: "BusChannel") -> list[int]:
    """Return the raw values of a quantity that the database calls invalid, wherever they are."""
    if channel.signal.length < _QUANTITY_FROM:
        return []
    named = dict(channel.signal.choices or {}).items()
    bare = ((int(value), re.sub(r"[\W_]", "", str(name)).casefold()) for value, name in named)
    return [value for value, name in bare if _INVALID.search(name)]


def plausible_range(channel: "BusChannel") -> tuple[float, float]:
    """Return the range of plausible values in the map's unit, widened by rounding errors.

    A canonical signal has the range of ``signals``, any other that of the DBC, if it has one.
    """
    signal, mapped = channel.signal, channel.mapped
    if mapped.name in signals.BY_NAME or signal.minimum is None or signal.maximum is None:
        return signals.plausible_range(mapped.name)
    limits = (float(limit) for limit in (signal.minimum, signal.maximum))
    low, high = sorted(limit * mapped.factor + mapped.offset for limit in limits)
    if not math.isfinite(high - low):
        return (-math.inf, math.inf)
    margin = 1e-9 * (high - low)
    return (low - margin, high + margin) if low < high else (-math.inf, math.inf)


def bit_position(message: Message, signal: Signal) -> int:
    """Return how far the signal's lowest bit lies above that of the payload's integer."""
    if signal.byte_order == "little_endian":
        return int(signal.start)
    first = 8 * (signal.start // 8) + 7 - signal.start % 8
    return int(8 * message.length - first - signal.length)


def last_byte(message: Message, signal: Signal) -> int:
    """Return the number of the last byte of the payload that holds a bit of the signal."""
    position = bit_position(message, signal)
    if signal.byte_order == "little_endian":
        return (position + signal.length - 1) // 8
    return int(message.length - 1 - position // 8)
