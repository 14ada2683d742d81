"""Datagrams that an interface cannot read: they are counted, and the bus stays."""

from typing import Final

import can

MOST: Final = 1000  # in a row with nothing else; then the interface is taken for lost


class Datagrams:
    """Tells a datagram that cannot be read from an interface that fails.

    An interface of python-can lets the errors of its parser through, or raises them as the cause
    of its own error. Errors of the operating system are those of the interface.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self._in_a_row = 0

    def survives(self, error: Exception) -> bool:
        """Count an error; return whether the bus may be read on."""
        cause = error.__cause__ if isinstance(error, can.CanError) else error
        if cause is None or isinstance(cause, OSError | can.CanError):
            return False
        self._in_a_row += 1
        if self._in_a_row > MOST:
            return False
        self.malformed += 1
        return True

    def read(self) -> None:
        """Note that the interface works."""
        self._in_a_row = 0
