"""Records, and the interface of the sinks that take them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

Value = float | int | bool | str
Tags = Mapping[str, str]  # said by the user, constant during a run


class Record(NamedTuple):
    """One event, or the signals of one moment."""

    kind: str  # "signals", "verdict", "code" or "cycle"
    t_ns: int  # clock of the frames
    values: Mapping[str, Value]  # of "signals" by path in the Vehicle Signal Specification


class RefusedError(Exception):
    """The sink will never take these records; they are dropped and counted."""


class Sink(Protocol):
    """Takes records; it may wait, because it runs on a thread of its own."""

    def write(self, records: Sequence[Record]) -> None:
        """Write the records; open the connection if it is not open.

        Raises RefusedError if they can never be written, any other error if they are to be given
        again after a while.
        """

    def close(self) -> None:
        """Close the connection; also called after every error, before the next ``write``."""
