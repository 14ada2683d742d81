"""When a recording began, by the clock of its file."""

from datetime import UTC, datetime, timedelta
from typing import Final

EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
DATED_FROM_NS: Final = 10**18  # the year 2001; a smaller time counts from the recording's start


def start_of(begin_ns: int) -> datetime | None:
    """Return the time of the first sample, None if times count from the start of the recording.

    >>> start_of(1_700_000_000_000_000_000).isoformat()
    '2023-11-14T22:13:20+00:00'
    """
    if begin_ns <= DATED_FROM_NS:
        return None
    return EPOCH + timedelta(microseconds=begin_ns // 1000)


def start_text(begin_ns: int) -> str | None:
    """Return the time of the first sample as ISO 8601, None without a date."""
    start = start_of(begin_ns)
    return None if start is None else start.isoformat()
