"""The source text of a message's decoder, and its compilation.

Generated code decodes a frame about five times as fast as walking the DBC's objects each time.
"""

import math
import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

from cantools.database.can import Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.types import Quality
from monitor.decode.bus_map import Channel
from monitor.decode.checksum import CRC8_TABLE, FINAL_XOR, start_value
from monitor.decode.open_tick import Received
from monitor.decode.raw_values import (
    bit_position,
    not_available_raw,
    plausible_range,
    plausible_raw,
    scaling,
)

Member = tuple[int, Channel]  # channel number, channel
Decode = Callable[[bytes, int], bool]
Conditions = tuple[tuple[str, tuple[int, ...]], ...]  # multiplexers with the values wanted
CLASSIC_LENGTH = 8  # bytes of a classic CAN frame
_BOUND = ("CRC", "counts", "sums", "goods", "worst", "times")


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
    members: Sequence[Member], counts: list[int], received: Received
) -> tuple[Decode, Callable[[], None]]:
    """Return the decoder of one message and a function that forgets its last counter.

    The decoder takes a frame's data and time, adds the values to what is received and returns
    whether the frame was used.

    members : the wanted channels of that message with their numbers
    counts : one place per Reason, raised by the decoder
    """
    scope: dict[str, Any] = {
        "counts": counts,
        "sums": received.sums,
        "goods": received.goods,
        "worst": received.worst,
        "times": received.times_ns,
        "CRC": list(CRC8_TABLE),  # a list is indexed faster than bytes
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
    by_byte = bool(channel.integrity.checksum) or message.length <= CLASSIC_LENGTH
    lines = [f"counts[{Reason.RECEIVED:d}] += 1", *_length_check(message, by_byte=by_byte)]
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
    bound = ", ".join(f"{name}={name}" for name in _BOUND)  # as fast as local names
    return (
        "def build():\n    due = -1\n"
        f"    def decode(data, t_ns, {bound}):\n        nonlocal due\n{body}\n"
        "    def reset():\n        nonlocal due\n        due = -1\n"
        "    return decode, reset\n"
    )


def _reject(reason: Reason) -> list[str]:
    return [f"    counts[{reason:d}] += 1", "    return False"]


def _length_check(message: Message, *, by_byte: bool) -> list[str]:
    """Return the code that refuses a wrong length, and names the bytes if that is wanted.

    A multiplexed message may be shorter: OBD responses come with and without padding.
    """
    names = f"{', '.join(f'b{byte}' for byte in range(message.length))}, = data"
    if message.is_multiplexed():
        lines = [
            "size = len(data)",
            f"if size > {message.length}:",
            *_reject(Reason.LENGTH),
            f'data = data.ljust({message.length}, b"\\0")',
        ]
        return [*lines, names] if by_byte else lines
    if by_byte:  # that they fit costs nothing to know
        return ["try:", f"    {names}", "except ValueError:", *_reject(Reason.LENGTH)]
    return [f"if len(data) != {message.length}:", *_reject(Reason.LENGTH)]


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
    bits = f" & {mask}" if signal.is_signed else ""
    return [
        f"count = {_raw(channel.message, signal)}{bits}",
        "if count != due:",
        "    if due >= 0:",
        f"        if count == (due - 1) & {mask}:",
        *(f"        {line}" for line in _reject(Reason.STUCK)),
        f"        counts[{Reason.LOST:d}] += (count - due) & {mask}",
        f"due = (count + 1) & {mask}",
    ]


def branches(members: Sequence[Member]) -> dict[Conditions, list[Member]]:
    """Return the members by the multiplexer values under which they come, the fewest first."""
    groups: dict[Conditions, list[Member]] = {}
    for member in members:
        groups.setdefault(multiplexing(member[1]), []).append(member)
    return dict(sorted(groups.items(), key=lambda item: len(item[0])))


def _branches(members: Sequence[Member]) -> list[str]:
    """Return the code that adds the values, one branch per multiplexer value.

    Nothing is added before the frame is known to be long enough for all that it carries.
    """
    groups = branches(members)
    if list(groups) == [()]:
        return [*_values(groups[()]), "return True"]
    message = members[0][1].message
    checks: list[str] = []
    values: list[str] = []
    for i, (conditions, group) in enumerate(groups.items()):
        tests = [
            f"{_raw(message, message.get_signal_by_name(name))} in {ids!r}"
            for name, ids in conditions
        ]
        needed = max(last_byte(message, channel.signal) for _, channel in group) + 1
        checks += [
            f"carries{i} = {' and '.join(tests) or True}",
            f"if carries{i} and size < {needed}:",
            *_reject(Reason.LENGTH),
        ]
        values += [f"if carries{i}:", *(f"    {line}" for line in _values(group))]
    carried = " or ".join(f"carries{i}" for i in range(len(groups)))
    return [*checks, f"if not ({carried}):", *_reject(Reason.OTHER), *values, "return True"]


def _values(members: Sequence[Member]) -> list[str]:
    lines = [line for index, channel in members for line in _value(index, channel)]
    return [*lines, " = ".join(f"times[{index}]" for index, _ in members) + " = t_ns"]


def _value(index: int, channel: Channel) -> list[str]:
    """Return the code that adds the value of one channel."""
    signal = channel.signal
    expression = scaling(channel)
    lines = [f"raw = {_raw(channel.message, signal)}"]
    if signal.is_float:
        low, high = plausible_range(channel)
        bounds = f"{low!r} <= value <= {high!r}".replace("inf", "INF")
        lines += [
            f"value = {expression}",
            f"if -INF < value < INF and {bounds}:",
            *_add(index, "value"),
        ]
        return [*lines, "else:", *_out_of_range(index)]
    bottom, top = plausible_raw(channel, expression)
    lowest = 0 if not signal.is_signed else None
    test = f"raw <= {top}" if bottom == lowest else f"{bottom} <= raw <= {top}"
    lines += [f"if {test}:", *_add(index, expression)]
    missing = not_available_raw(channel)
    if missing is not None:
        lines += [f"elif raw == {missing}:", *_not_available(index)]
    return [*lines, "else:", *_out_of_range(index)]


def _add(index: int, expression: str) -> list[str]:
    return [f"    sums[{index}] += {expression}", f"    goods[{index}] += 1"]


def _not_available(index: int) -> list[str]:
    return [
        f"    if worst[{index}] < {Quality.INVALID:d}:",
        f"        worst[{index}] = {Quality.INVALID:d}",
        f"    counts[{Reason.NOT_AVAILABLE:d}] += 1",
    ]


def _out_of_range(index: int) -> list[str]:
    return [
        f"    worst[{index}] = {Quality.OUT_OF_RANGE:d}",
        f"    counts[{Reason.OUT_OF_RANGE:d}] += 1",
    ]


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
