"""Raw values of a DBC signal: their place, their meaning, their plausible range."""

import math
from collections.abc import Callable
from typing import Any

from cantools.database.can import Message, Signal

from monitor.base import signals
from monitor.decode.bus_map import BusChannel


def not_available_raw(channel: BusChannel) -> int | None:
    """Return the raw value that says not available, None if the signal has none."""
    signal = channel.signal
    if not channel.integrity.not_available or signal.length < 2 or signal.is_float:
        return None
    if signal.is_signed:
        return int(-(1 << (signal.length - 1)))
    return int((1 << signal.length) - 1)


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


def scaling(channel: BusChannel) -> Callable[[Any], Any]:
    """Return the function from raw values, floats, to values in the map's unit."""
    signal, mapped = channel.signal, channel.mapped
    steps = ((signal.scale, signal.offset), (mapped.factor, mapped.offset))
    lines = [
        (float(factor), float(offset)) for factor, offset in steps if (factor, offset) != (1, 0)
    ]

    def scaled(raw: Any) -> Any:
        for factor, offset in lines:
            raw = raw * factor + offset
        return raw

    return scaled


def plausible_raw(channel: BusChannel) -> tuple[int, int]:
    """Return the lowest and highest raw value that is plausible; empty if none is.

    The range is checked on integers, because that is faster, with the decoder's own arithmetic.
    """
    bits = channel.signal.length
    bottom, top = (0, (1 << bits) - 1)
    if channel.signal.is_signed:
        bottom, top = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    missing = not_available_raw(channel)
    bottom, top = bottom + (bottom == missing), top - (top == missing)
    low, high = plausible_range(channel)
    scaled = scaling(channel)
    if scaled(float(bottom)) > scaled(float(top)):  # a negative factor
        first = _bisect(lambda raw: scaled(float(raw)) <= high, bottom, top)
        last = _bisect(lambda raw: scaled(float(raw)) < low, bottom, top) - 1
    else:
        first = _bisect(lambda raw: scaled(float(raw)) >= low, bottom, top)
        last = _bisect(lambda raw: scaled(float(raw)) > high, bottom, top) - 1
    return first, last


def _bisect(holds: Callable[[int], bool], bottom: int, top: int) -> int:
    """Return the first integer from ``bottom`` for which ``holds``, ``top + 1`` if none."""
    top += 1
    while bottom < top:
        middle = (bottom + top) // 2
        if holds(middle):
            top = middle
        else:
            bottom = middle + 1
    return bottom


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
