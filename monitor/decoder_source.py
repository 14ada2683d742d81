"""The source text of a message's decoder, and its compilation.

Generated code decodes a frame about five times as fast as walking the DBC's objects each time.
"""

import math
import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

from cantools.database.can import Message, Signal

from monitor.bus_map import Channel
from monitor.checksum import CRC8_TABLE, FINAL_XOR, start_value
from monitor.errors import SignalMapError
from monitor.raw_values import (
    bit_position,
    not_available_raw,
    plausible_range,
    plausible_raw,
    scaling,
)
from monitor.types import Update

Member = tuple[int, Channel]  # channel number, channel
Conditions = tuple[tuple[str, tuple[int, ...]], ...]  # multiplexers with the values wanted
CLASSIC_LENGTH = 8  # bytes of a classic CAN frame


class Reason(IntEnum):
    """Places in a message's list of counts."""

    RECEIVED = 0
    LENGTH = 1
    CHECKSUM = 2
    STUCK = 3
    OTHER = 4
    LOST = 5
    NOT_AVAILABLE = 6
    OUT_OF_RANGE = 7


def build_decoder(
    members: Sequence[Member], counts: list[int]
) -> tuple[Callable[[bytes], Update | None], Callable[[], None]]:
    """Return the decoder of one message and a function that forgets its last counter.

    members : the wanted channels of that message with their numbers
    counts : one place per Reason, raised by the decoder
    """
    scope: dict[str, Any] = {
        "counts": counts,
        "CRC": list(CRC8_TABLE),  # a list is indexed faster than bytes
        "NAN": math.nan,
        "INF": math.inf,
        "from_bytes": int.from_bytes,
        "FLOATS": {16: struct.Struct("<e"), 32: struct.Struct("<f"), 64: struct.Struct("<d")},
    }
    text = decoder_source(members)
    exec(compile(text, f"<decoder of {members[0][1].message.name}>", "exec"), scope)
    decode, reset = scope["build"]()
    return decode, reset


def decoder_source(members: Sequence[Member]) -> str:
    """Return the Python text of a message's decoder; see ``build_decoder``."""
    channel = members[0][1]
    message = channel.message
    lines = [f"counts[{Reason.RECEIVED:d}] += 1", *_length_check(message)]
    if channel.integrity.checksum or message.length <= CLASSIC_LENGTH:
        lines.append(f"{', '.join(f'b{byte}' for byte in range(message.length))}, = data")
    if channel.integrity.checksum:
        lines += _checksum_check(channel)
    signals = [each.signal for _, each in members]
    if channel.integrity.counter:
        signals.append(_named(channel, channel.integrity.counter))
    signals += [message.get_signal_by_name(name) for name in _multiplexers(members)]
    for order, variable in (("little_endian", "low"), ("big_endian", "high")):
        if any(s.byte_order == order and _bytes(message, s) is None for s in signals):
            lines.append(f'{variable} = from_bytes(data, "{order.split("_")[0]}")')
    if channel.integrity.counter:
        lines += _counter_check(channel)
    lines += _branches(members)
    body = "\n".join(f"        {line}" for line in lines)
    return (
        "def build():\n    last = due = -1\n"
        f"    def decode(data, CRC=CRC, counts=counts):\n        nonlocal last, due\n{body}\n"
        "    def reset():\n        nonlocal last, due\n        last = due = -1\n"
        "    return decode, reset\n"
    )


def _reject(reason: Reason) -> list[str]:
    return [f"    counts[{reason:d}] += 1", "    return None"]


def _length_check(message: Message) -> list[str]:
    """A multiplexed message may be shorter: OBD responses come with and without padding."""
    if not message.is_multiplexed():
        return [f"if len(data) != {message.length}:", *_reject(Reason.LENGTH)]
    return [
        "size = len(data)",
        f"if size > {message.length}:",
        *_reject(Reason.LENGTH),
        f'data = data.ljust({message.length}, b"\\0")',
    ]


def checksum_byte(channel: Channel) -> int:
    """Return the number of the byte that holds the message's checksum.

    Raises SignalMapError if it does not fill one.
    """
    message, signal = channel.message, _named(channel, channel.integrity.checksum)
    if signal.length != 8 or bit_position(message, signal) % 8 or signal.is_signed:
        raise SignalMapError(
            f"{channel.map_path}: checksum {message.name}.{signal.name} of {channel.dbc} "
            "must be an unsigned byte of its own"
        )
    return int(signal.start // 8)


def _checksum_check(channel: Channel) -> list[str]:
    message, integrity = channel.message, channel.integrity
    place = checksum_byte(channel)
    expression = str(start_value(integrity.algorithm, message.frame_id))
    for byte in range(message.length):
        if byte != place:
            expression = f"CRC[{expression} ^ b{byte}]"
    return [
        f"if {expression} ^ {FINAL_XOR} != b{place}:",
        *_reject(Reason.CHECKSUM),
    ]


def _counter_check(channel: Channel) -> list[str]:
    """A counter that stands still is rejected; one that jumps tells how many frames are lost."""
    signal = _named(channel, channel.integrity.counter)
    mask = (1 << signal.length) - 1
    return [
        f"count = {_raw(channel.message, signal)}",
        "if count != due:",
        "    if count == last:",
        *(f"    {line}" for line in _reject(Reason.STUCK)),
        "    if last >= 0:",
        f"        counts[{Reason.LOST:d}] += (count - due) & {mask}",
        "last = count",
        f"due = (count + 1) & {mask}",
    ]


def branches(members: Sequence[Member]) -> dict[Conditions, list[Member]]:
    """Return the members by the multiplexer values under which they come, the fewest first."""
    groups: dict[Conditions, list[Member]] = {}
    for member in members:
        groups.setdefault(multiplexing(member[1]), []).append(member)
    return dict(sorted(groups.items(), key=lambda item: len(item[0])))


def _branches(members: Sequence[Member]) -> list[str]:
    """Return the code that decodes and returns the values, one branch per multiplexer value."""
    groups = branches(members)
    if list(groups) == [()]:
        return _values(groups[()])
    message = members[0][1].message
    lines = ["indices = ()", "values = ()"]
    for conditions, group in groups.items():
        tests = [
            f"{_raw(message, message.get_signal_by_name(name))} in {ids!r}"
            for name, ids in conditions
        ]
        needed = max(last_byte(message, channel.signal) for _, channel in group) + 1
        code = _values(group)
        code[-1] = code[-1].replace("return ", "more = ")
        if tests:
            lines.append(f"if {' and '.join(tests)}:")
        else:
            lines.append("if True:")
        lines += [
            f"    if size < {needed}:",
            *(f"    {line}" for line in _reject(Reason.LENGTH)),
            *(f"    {line}" for line in code),
            "    indices += more[0]",
            "    values += more[1]",
        ]
    return [*lines, "if not indices:", *_reject(Reason.OTHER), "return indices, values"]


def _values(members: Sequence[Member]) -> list[str]:
    lines: list[str] = []
    for index, channel in members:
        lines += _value(f"x{index}", channel)
    indices = ", ".join(str(index) for index, _ in members)
    values = ", ".join(f"x{index}" for index, _ in members)
    return [*lines, f"return ({indices},), ({values},)"]


def _value(name: str, channel: Channel) -> list[str]:
    """Return the code that sets ``name`` to the value of one channel."""
    signal = channel.signal
    expression = scaling(channel)
    lines = [f"raw = {_raw(channel.message, signal)}"]
    if signal.is_float:
        low, high = plausible_range(channel)
        bounds = f"{low!r} <= {name} <= {high!r}".replace("inf", "INF")
        return [
            *lines,
            f"{name} = {expression}",
            f"if not -INF < {name} < INF or not {bounds}:",
            *_mark(name, "INF", Reason.OUT_OF_RANGE),
        ]
    bottom, top = plausible_raw(channel, expression)
    lowest = 0 if not signal.is_signed else None
    test = f"raw <= {top}" if bottom == lowest else f"{bottom} <= raw <= {top}"
    lines += [f"if {test}:", f"    {name} = {expression}"]
    missing = not_available_raw(channel)
    if missing is not None:
        lines += [f"elif raw == {missing}:", *_mark(name, "NAN", Reason.NOT_AVAILABLE)]
    return [*lines, "else:", *_mark(name, "INF", Reason.OUT_OF_RANGE)]


def _mark(name: str, value: str, reason: Reason) -> list[str]:
    return [f"    {name} = {value}", f"    counts[{reason:d}] += 1"]


def _named(channel: Channel, name: str) -> Signal:
    return channel.message.get_signal_by_name(name)


def multiplexing(channel: Channel) -> Conditions:
    """Return the multiplexer values under which the frame carries the channel, outermost first."""
    found: list[tuple[str, tuple[int, ...]]] = []
    signal = channel.signal
    while signal.multiplexer_signal is not None:
        found.append((signal.multiplexer_signal, tuple(signal.multiplexer_ids or ())))
        signal = _named(channel, signal.multiplexer_signal)
    return tuple(reversed(found))


def _multiplexers(members: Sequence[Member]) -> list[str]:
    return [name for _, channel in members for name, _ in multiplexing(channel)]


def last_byte(message: Message, signal: Signal) -> int:
    """Return the number of the last byte of the payload that holds a bit of the signal."""
    position = bit_position(message, signal)
    if signal.byte_order == "little_endian":
        return (position + signal.length - 1) // 8
    return message.length - 1 - position // 8


def _raw(message: Message, signal: Signal) -> str:
    """Return the expression of the signal's raw value."""
    position = bit_position(message, signal)
    found = _bytes(message, signal)
    if found is None:
        variable = "low" if signal.byte_order == "little_endian" else "high"
        width = 8 * message.length
    else:  # arithmetic on small integers is faster
        variable = f"b{found[0]}" if len(found) == 1 else f"(b{found[0]} | b{found[1]} << 8)"
        width = 8 * len(found)
        position %= 8
    value = f"({variable} >> {position})" if position else variable
    if position + signal.length < width:
        value = f"({value} & {(1 << signal.length) - 1:#x})"
    if signal.is_float:
        return (
            f"FLOATS[{signal.length}].unpack({value}.to_bytes({signal.length // 8}, 'little'))[0]"
        )
    if signal.is_signed:
        sign = 1 << (signal.length - 1)
        return f"(({value} ^ {sign:#x}) - {sign:#x})"
    return value


def _bytes(message: Message, signal: Signal) -> tuple[int, ...] | None:
    """Return the signal's bytes, lowest first, if it lies in one or two of a classic frame."""
    first = bit_position(message, signal) // 8
    last = (bit_position(message, signal) + signal.length - 1) // 8
    if message.length > CLASSIC_LENGTH or last - first > 1:
        return None
    places = range(first, last + 1)
    if signal.byte_order == "little_endian":
        return tuple(places)
    return tuple(message.length - 1 - place for place in places)
