"""The wire format of protobuf, as far as a model file needs it: fields of a message, one by one.

Source: protobuf.dev, Encoding. Reading it here costs no library, and bounds what a hostile file can
make the reader do.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

VARINT: Final = 0
FIXED64: Final = 1
BYTES: Final = 2
FIXED32: Final = 5
VARINT_BYTES: Final = 10  # most that a varint has
_FIXED: Final = {FIXED64: 8, FIXED32: 4}


class Field(NamedTuple):
    """One field of a message."""

    number: int
    wire: int
    value: int | memoryview  # the content of a field of bytes or fixed size
    raw: memoryview  # the whole field, with its key


class Parts:
    """Counts the fields that are read, so that no file can have too many."""

    def __init__(self, most: int) -> None:
        self._left = most

    def fields(self, message: memoryview) -> Iterator[Field]:
        """Yield the fields of a message; raises ValueError if it is none, or too large."""
        at = 0
        while at < len(message):
            self._left -= 1
            if self._left < 0:
                raise ValueError("it has too many parts")
            begin = at
            key, at = varint(message, at)
            number, wire = key >> 3, key & 7
            if wire == VARINT:
                value, at = varint(message, at)
                yield Field(number, wire, value, message[begin:at])
                continue
            if wire == BYTES:
                size, at = varint(message, at)
            elif wire in _FIXED:
                size = _FIXED[wire]
            else:
                raise ValueError(f"it has a field of the unknown kind {wire}")
            if at + size > len(message):
                raise ValueError("it is cut off")
            yield Field(number, wire, message[at : at + size], message[begin : at + size])
            at += size


def varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return a number that begins at a byte, and the byte after it; raises ValueError."""
    value = shift = 0
    for byte in message[at : at + VARINT_BYTES]:
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise ValueError("it is cut off")


def numbers(field: Field) -> list[int]:
    """Return the numbers of a field that is packed or holds one number; raises ValueError."""
    if isinstance(field.value, int):
        return [field.value]
    found, at = list[int](), 0
    while at < len(field.value):
        value, at = varint(field.value, at)
        found.append(value)
    return found


def content(field: Field) -> memoryview:
    """Return the content of a field of bytes; raises ValueError for others."""
    if isinstance(field.value, int) or field.wire != BYTES:
        raise ValueError(f"field {field.number} is a number")
    return field.value


def text(field: Field) -> str:
    """Return the text of a field; raises ValueError if it is none."""
    return bytes(content(field)).decode()


def number(field: Field) -> int:
    """Return the number of a field; raises ValueError if it is none."""
    if not isinstance(field.value, int):
        raise ValueError(f"field {field.number} is no number")
    return field.value
