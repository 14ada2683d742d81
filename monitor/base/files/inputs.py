"""Opening of input files: regular files only, small files read whole, TOML with one error line.

A FIFO, a socket or a device is refused: reading one can wait for ever or never end. Every file that
a command reads is opened here, so that no input needs more memory than its kind deserves.
"""

import errno
import math
import os
import stat
import tomllib
from pathlib import Path
from typing import Any, BinaryIO, Final

from monitor.base.errors import O2Error

SMALL_BYTES: Final = 1 << 20  # a settings file, map or manifest; the largest real one has 200 kB
_TOML_BITS: Final = 64
_KINDS: Final = (
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)

_NO_WAIT: Final = getattr(os, "O_NONBLOCK", 0)  # Windows has none, and no FIFOs that wait


def other_kind(mode: int) -> str | None:
    """Return the kind of a file by its mode; None for a regular file or a folder.

    >>> other_kind(stat.S_IFIFO)
    'a FIFO'
    """
    return next((kind for is_kind, kind in _KINDS if is_kind(mode)), None)


def open_regular(path: str | Path) -> BinaryIO:
    """Open a regular file for reading; never waits.

    Raises OSError with the reason in ``strerror``; a FIFO, socket or device is a reason.
    """
    mode = Path(path).stat().st_mode  # a socket and some devices cannot even be opened
    if kind := other_kind(mode):
        raise OSError(errno.EINVAL, f"is {kind}, a regular file is wanted", str(path))
    return open(path, "rb", opener=lambda name, flags: os.open(name, flags | _NO_WAIT))


def read_small(path: str | Path, most_bytes: int = SMALL_BYTES) -> bytes:
    """Return the content of a small file.

    Raises OSError with the reason in ``strerror``, also if the file has more than ``most_bytes``.
    """
    with open_regular(path) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(
            errno.EFBIG, f"has more than {most_bytes:,} bytes, a small file is wanted", str(path)
        )
    return content


def read_toml(path: Path, what: str, error: type[O2Error]) -> dict[str, Any]:
    """Return the tree of a TOML file.

    what : the file's name in the message, such as "the signal map"
    Raises ``error`` with path and reason in one line if it cannot be read or is no TOML.
    """
    try:
        tree = tomllib.loads(read_small(path).decode())
    except OSError as reason:
        raise error(f"{path}: cannot read {what}: {reason.strerror}") from None
    except RecursionError:
        raise error(f"{path}: not a TOML file: nested too deeply") from None
    except ValueError as reason:  # TOML's own, of the text's encoding, of a number too long
        raise error(f"{path}: not a TOML file: {' '.join(str(reason).split())}") from None
    if problem := _long_number(tree):
        raise error(f"{path}: {problem}")
    return tree


def _long_number(tree: dict[str, Any]) -> str | None:
    """Return where an integer of more than 64 bits stands, which TOML does not know, and its size.

    >>> _long_number({"window": {"n_samples": 1 << 64}})
    '[window] n_samples is a number of 65 bits, 64 are the most'
    """
    waiting: list[tuple[tuple[str, ...], object]] = [((), tree)]
    while waiting:
        keys, node = waiting.pop()
        if isinstance(node, dict):
            waiting.extend(((*keys, key), value) for key, value in node.items())
        elif isinstance(node, list):
            waiting.extend((keys, value) for value in node)
        elif isinstance(node, int) and node.bit_length() > _TOML_BITS:
            *tables, key = keys
            where = f"[{'.'.join(tables)}] {key}" if tables else key
            return f"{where} is a number of {node.bit_length():,} bits, {_TOML_BITS} are the most"
    return None


def as_number(value: object) -> float | None:
    """Return a value of a TOML or JSON file as a finite number, None if it is none.

    >>> as_number(3), as_number(True), as_number(10**400)
    (3.0, None, None)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # an integer of hundreds of digits
        return None
    return number if math.isfinite(number) else None


def in_words(value: object, most: int = 60) -> str:
    """Return a value as an error line shows it: its beginning, on one line.

    >>> in_words([1] * 100)
    '[1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,…'
    """
    text = repr(value)
    return text if len(text) <= most else f"{text[:most]}…"
