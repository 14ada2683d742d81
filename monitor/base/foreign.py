"""Calls into a plug-in's code: it may fail in any way, and is named in clean text."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from monitor.base.errors import O2Error

T = TypeVar("T")
_LONGEST = 300  # characters of somebody else's message


class ForeignError(O2Error):
    """Somebody else's code has failed, or returned something else than was wanted."""


def one_line(text: object) -> str:
    """Return a text without line ends and characters that move a terminal's cursor.

    >>> one_line("no\\x1b[2J such\\nhost")
    'no\\\\x1b[2J such host'
    """
    words = " ".join(str(text).split())[:_LONGEST]
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in words)


@contextmanager
def foreign(name: str) -> Iterator[None]:
    """Raise ForeignError, which names the code, for everything that it raises.

    ``sys.exit`` within it is a failure as any other; only an interrupt of the user passes.
    """
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:
        raise ForeignError(f"{name} fails: {one_line(error) or type(error).__name__}") from error


def returned(name: str, call: Callable[[], object], wanted: type[T]) -> T:
    """Return what a plug-in returns; raises ForeignError if it fails or returns another type."""
    with foreign(name):
        found = call()
    if not isinstance(found, wanted):
        kind = type(found).__name__
        raise ForeignError(f"{name} returned {kind}, {wanted.__name__} is wanted")
    return found
