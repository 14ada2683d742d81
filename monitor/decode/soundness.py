"""Whether a database's message and signal can be decoded at all; the refusal of those that cannot.

cantools takes what the grammar of a format allows: messages of no bytes, infinite factors, floats
of 17 bits, ranges of ten million multiplexer values. Only messages that a map uses are checked: a
database may hold strange ones elsewhere.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.files.inputs import in_words
from monitor.decode.raw_values import bit_position
from monitor.frames.blocks import MAX_BYTES

MOST_LETTERS: Final = 1000  # of a name; DBC allows 128
MOST_BYTES: Final = 64 << 20  # of a database file; large ones of whole vehicles have 10 MB
MOST_SWITCHES: Final = 1 << 16  # values of one multiplexer: 16 bits
MOST_BITS: Final = 8 * 64  # of a signal: a whole CAN FD frame
_FLOATS: Final = (16, 32, 64)
_IDENTIFIERS: Final = {False: 1 << 11, True: 1 << 29}
_RANGES: Final = re.compile(rb"\bSG_MUL_VAL_\s+(\d+)\s+(\w+)\s+\w+\s+([^;]*);")  # on any line
# Sizes and places of millions, which cantools would turn into as many parts of a format.
_MILLIONS: Final = rb"-?0*[1-9]\d{6,}"
_SIZES: Final = {
    ".dbc": re.compile(
        rb"\bSG_\s+(?P<name>\w+)[^:\n]*:\s*(?:\d+\s*\|\s*)?(?P<n>%b)\s*[|@]|"
        rb"\bBO_\s+\d+\s+(?P<message>\w+)\s*:\s*(?P<bytes>%b)\s" % (_MILLIONS, _MILLIONS)
    ),
    ".kcd": re.compile(rb"\b(?P<name>offset|length|count)\s*=\s*[\"'](?P<n>%b)" % _MILLIONS),
    ".sym": re.compile(
        rb"^\s*(?P<name>Len|Mux|Var|Sig)\s*=(?:[^\n]*[\s,])??(?P<n>%b)\b" % _MILLIONS, re.MULTILINE
    ),
    ".arxml": re.compile(rb"<(?P<name>LENGTH|START-POSITION)>\s*(?P<n>%b)" % _MILLIONS),
}
_RANGE: Final = re.compile(rb"(\d+)-\s*(\d+)")


def check_text(path: Path, content: bytes) -> None:
    """Raise SignalMapError for numbers with which the parser would take minutes or all memory.

    The parser writes every multiplexer value of a range into a list, and makes a format of every
    signal; so this comes before the parser.
    """
    sizes = _SIZES.get(path.suffix.lower())
    if sizes and (found := sizes.search(content)):
        groups = {key: text.decode() for key, text in found.groupdict().items() if text}
        name = groups.get("name") or groups.get("message")
        n = groups.get("n") or groups.get("bytes", "")
        raise SignalMapError(
            f"{path}: {name} has a size or place of {in_words(n)}, less than a million is wanted"
        )
    for message, signal, ranges in _RANGES.findall(content):
        n = 0
        for first, last in _RANGE.findall(ranges):
            is_short = max(len(first), len(last)) < 20
            n += max(int(last) - int(first) + 1, 0) if is_short else MOST_SWITCHES + 1
        if n > MOST_SWITCHES:
            raise SignalMapError(
                f"{path}: signal {signal.decode()} of message {message.decode()} comes under "
                f"{n:,} multiplexer values or more, at most {MOST_SWITCHES:,} are wanted"
            )


def check_names(path: Path, database: Database) -> None:
    """Raise SignalMapError for messages or signals without a name, or with an endless one."""
    for message in database.messages:
        for name in (message.name, *(signal.name for signal in message.signals)):
            if not isinstance(name, str) or not 1 <= len(name) <= MOST_LETTERS:
                where = f"a signal of {message.name}" if message.name else "a message"
                raise SignalMapError(
                    f"{path}: {where[:60]} has no name or one of more than {MOST_LETTERS} letters"
                )


def check_message(path: Path, message: Message) -> None:
    """Raise SignalMapError if no CAN frame can be this message."""
    where = f"{path}: message {message.name}"
    if not 1 <= message.length <= MAX_BYTES:
        raise SignalMapError(f"{where} has {message.length} bytes, 1 to {MAX_BYTES} are wanted")
    if not 0 <= message.frame_id < _IDENTIFIERS[message.is_extended_frame]:
        bits = 29 if message.is_extended_frame else 11
        raise SignalMapError(
            f"{where} has the identifier {message.frame_id:#x}, {bits} bits are wanted"
        )


def check_signal(path: Path, message: Message, name: str) -> None:
    """Raise SignalMapError if a signal, or a multiplexer that it needs, cannot be decoded."""
    for signal in _with_multiplexers(path, message, name):
        where = f"{path}: signal {message.name}.{signal.name}"
        for problem in _problems(message, signal):
            raise SignalMapError(f"{where} {problem}")


def _with_multiplexers(path: Path, message: Message, name: str) -> Iterator[Signal]:
    """Yield the signal, its multiplexer, that one's multiplexer, and so on."""
    signals = {signal.name: signal for signal in message.signals}
    signal, seen = signals[name], {name}
    yield signal
    while (above := signal.multiplexer_signal) is not None:
        where = f"{path}: signal {message.name}.{signal.name}"
        if above not in signals:
            raise SignalMapError(f"{where} has the multiplexer {above}, which the message lacks")
        if above in seen:
            raise SignalMapError(f"{where} has the multiplexer {above}, which depends on it")
        if signals[above].is_float:
            raise SignalMapError(f"{where} has the multiplexer {above}, a float; integers switch")
        seen.add(above)
        signal = signals[above]
        yield signal


def _problems(message: Message, signal: Signal) -> Iterator[str]:
    """Yield the mistakes of one signal, and the wanted value beside each."""
    if not 1 <= signal.length <= MOST_BITS:
        yield f"has {signal.length} bits, 1 to {MOST_BITS} are wanted"
    if signal.is_float and signal.length not in _FLOATS:
        yield f"is a float of {signal.length} bits, 16, 32 or 64 are wanted"
    if not 0 <= bit_position(message, signal) <= 8 * message.length - signal.length:
        yield (
            f"starts at bit {signal.start} with {signal.length} bits, beyond the {message.length} "
            "bytes of its message"
        )
    for what, value in (("factor", signal.scale), ("offset", signal.offset)):
        if not abs(value) <= sys.float_info.max:  # also NaN, and integers that no float holds
            yield f"has the {what} {in_words(value)}, a finite number is wanted"
    for what, limit in (("minimum", signal.minimum), ("maximum", signal.maximum)):
        if isinstance(limit, int) and abs(limit) > sys.float_info.max:
            yield f"has the {what} {in_words(limit)}, a number that a float holds is wanted"
    if signal.scale == 0:
        yield "has the factor 0, another number is wanted"
    if len(signal.multiplexer_ids or ()) > MOST_SWITCHES:
        yield f"comes under more than {MOST_SWITCHES:,} multiplexer values"
