"""Raw values of a DBC signal: their place, their meaning, their plausible range."""

import math

from cantools.database.can import Message, Signal

from monitor.base import signals
from monitor.decode.bus_map import BusChannel


def not_available_raw(channel: BusChannel) -> int | None:
    """Return the raw value that says not available, None if the signal has none."""
    signal = channel.signal
    if not channel.integrity.not_available or signal.length < 2 or signal.is_float:
        return None
    return int(-(1 << (signal.length - 1)) if signal.is_signed else (1 << signal.length) - 1)


def plausible_range(channel: BusChannel) -> tuple[float, float]:
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
