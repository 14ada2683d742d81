"""When a recording began, by the clock of its file or else by the date in its name."""

import re
from datetime import UTC, datetime
from pathlib import PurePath
from typing import Final

DATED_FROM_NS: Final = 10**18  # the year 2001; a smaller time counts from the recording's start
_IN_NAME: Final = re.compile(r"(?<!\d)(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)[-_. T]?(\d\d)[-_.:]?(\d\d)")


def start_of(begin_ns: int, path: str | PurePath) -> datetime | None:
    """Return the time of the first sample (of a name: in its unknown zone), None without a date.

    >>> start_of(0, "logs/2016-08-06_01.16.04.msl").isoformat()
    '2016-08-06T01:16:00+00:00'
    >>> start_of(0, "vehicle_12020010112301.csv") is None
    True
    """
    if begin_ns > DATED_FROM_NS:
        return datetime.fromtimestamp(begin_ns // 1000 / 1e6, UTC)
    found = _IN_NAME.search(PurePath(path).name)
    try:
        return datetime.fromisoformat("{}{}{}T{}{}Z".format(*found.groups())) if found else None
    except ValueError:  # numbers that are no date
        return None
