"""Ways to damage a log, a table or any other file: bits, bytes, numbers, lines, packing.

Each takes the file's bytes and a generator of random numbers and returns other bytes.
"""

import random
import struct
import zlib
from collections.abc import Callable
from itertools import chain, pairwise

NUMBERS = (
    *(b"nan inf -inf 1e308 -1 0 1e-320 9007199254740993 4294967296 -9223372036854775809".split()),
    *(b"1_0 0x10 1e5 99999999999 \xd9\xa3 ,, ;".split()),
    b"9" * 5000,
    b"",
)
WORDS = tuple(
    struct.pack("<Q", n)
    for n in (0, 1, 23, 64, 2**16, 2**31, 2**32 - 1, 2**32, 2**40, 2**63, 2**64 - 1)
)

Mutation = Callable[[bytearray, random.Random], bytes]


def flip(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with some bits flipped."""
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def write_over(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with a run of bytes replaced."""
    at, n = rng.randrange(len(data)), rng.choice((1, 4, 8, 100, 5000))
    data[at : at + n] = rng.choice(
        (rng.randbytes(n), bytes(n), b"\xff" * n, b"\n" * n, b"A" * n, b"[" * n)
    )
    return bytes(data)


def cut(data: bytearray, rng: random.Random) -> bytes:
    """Return the data without its end."""
    return bytes(data[: rng.randrange(1, len(data))])


def leave_out(data: bytearray, rng: random.Random) -> bytes:
    """Return the data without a run of bytes."""
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 7, 200, 20_000))]
    return bytes(data)


def double(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with a run of bytes put in again elsewhere."""
    at, to, n = rng.randrange(len(data)), rng.randrange(len(data)), rng.choice((8, 200, 20_000))
    data[to:to] = data[at : at + n] * rng.choice((1, 1, 1, 50))
    return bytes(data)


def word(data: bytearray, rng: random.Random) -> bytes:
    """Return the data with a field of 4 or 8 bytes made a number that no logger writes."""
    for _ in range(rng.choice((1, 1, 3))):
        value = rng.choice(WORDS)[: rng.choice((4, 8))]
        at = rng.randrange(min(len(data), rng.choice((64, 700, len(data)))))
        data[at : at + len(value)] = value
    return bytes(data)


def number(data: bytearray, rng: random.Random) -> bytes:
    """Return a text with one or many numbers replaced."""
    lines = bytes(data).splitlines(keepends=True)
    row = rng.randrange(len(lines))
    separator = rng.choice((b" ", b",", b"#", b"."))
    for line in range(row, min(len(lines), row + rng.choice((1, 1, 2, 1000)))):
        cells = lines[line].split(separator)
        cells[rng.randrange(len(cells))] = rng.choice(NUMBERS)
        lines[line] = separator.join(cells)
    return b"".join(lines)


def lines_of_order(data: bytearray, rng: random.Random) -> bytes:
    """Return a text whose lines or stretches are in another order, doubled or left out."""
    lines = bytes(data).splitlines(keepends=True)
    match rng.randrange(6):
        case 0:
            rng.shuffle(lines)
        case 4 | 5:
            cuts = sorted(rng.choices(range(len(lines)), k=rng.choice((1, 2, 5, 20))))
            edges = [rng.choice((0, 20)), *cuts, len(lines)]  # a header stays, or it does not
            stretches = [lines[begin:end] for begin, end in pairwise(edges)]
            rng.shuffle(stretches)
            lines = [*lines[: edges[0]], *chain.from_iterable(stretches)]
        case 1:
            lines = lines[::-1]
        case 2:
            lines = [line for line in lines if rng.random() < 0.9]
        case _:
            at = rng.randrange(len(lines))
            lines[at:at] = lines[:at]
    return b"".join(lines)


def ends(data: bytearray, rng: random.Random) -> bytes:
    """Return a text with other line ends, a byte order mark, or zeros between."""
    text = bytes(data)
    return rng.choice(
        (
            text.replace(b"\n", b"\r"),
            text.replace(b"\n", b"\r\n"),
            b"\xef\xbb\xbf" + text,
            text.decode("latin-1").encode("utf-16"),
            text.replace(b"\n", b"\n\n\n"),
            text.replace(b"\n", b"\0\n"),
            text.replace(b"\n", b" "),
        )
    )


BINARY: tuple[Mutation, ...] = (flip, write_over, cut, leave_out, double, word, word)
TEXT: tuple[Mutation, ...] = (*BINARY[:-2], number, number, lines_of_order, ends)


def in_containers(data: bytes, mutate: Mutation, rng: random.Random) -> bytes:
    """Return a BLF file whose containers hold changed objects."""
    parts, position = [], data.index(b"LOBJ")
    parts.append(data[:position])
    while position < len(data):
        _, _, _, size, kind = struct.unpack_from("<4sHHLL", data, position)
        body = data[position + 32 : position + size]
        if kind == 10:
            inner = mutate(bytearray(zlib.decompress(body)), rng)
            body = zlib.compress(inner)
            head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(body), 10)
            body = head + struct.pack("<H6xL4x", 2, len(inner)) + body
            parts.append(body + bytes(len(body) % 4))
        position += size + size % 4
    return b"".join(parts)
