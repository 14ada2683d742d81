"""Records, their JSON, and the interface of the sinks that take them."""

import json
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple, Protocol

Value = float | int | bool | str
Tags = Mapping[str, str]  # said by the user, constant during a run
# Names that records have beside those of signals and of a health's counters: no tag has them.
FIELDS: Final = frozenset(
    {
        *("kind", "t_ns", "of", "verdict", "fault", "mean", "code", "also", "state", "status"),
        *("started", "predicted", "residual", "enabled", "waits_for", "windows", "mil", "dtcs"),
    }
)


class Record(NamedTuple):
    """One event, or the signals of one moment."""

    kind: str  # "signals", "verdict", "code", "cycle" or "health"
    t_ns: int  # clock of the frames
    values: Mapping[str, Value]


class Sink(Protocol):
    """Takes records; it may wait, because a run gives it a thread of its own."""

    def write(self, records: Sequence[Record]) -> None:
        """Write the records; open the connection if it is not open.

        May raise any error; the records are then given again after a while.
        """

    def close(self) -> None:
        """Close the connection; also called after every error, before the next ``write``."""


def json_of(record: Record, tags: Tags) -> str:
    """Return a record as one flat JSON object, floats with nine digits.

    >>> json_of(Record("code", 7, {"code": "P0133", "status": 47}), {"vehicle": "17"})
    '{"kind": "code", "t_ns": 7, "vehicle": "17", "code": "P0133", "status": 47}'
    """
    values = {k: float(f"{v:.9g}") if type(v) is float else v for k, v in record.values.items()}
    return json.dumps({"kind": record.kind, "t_ns": record.t_ns, **tags, **values})
