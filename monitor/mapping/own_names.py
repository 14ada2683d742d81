"""The part of a signal's name behind the beginning that all names of its message share."""

import re
from collections import Counter
from functools import lru_cache
from typing import Final

from cantools.database.can import Message, Signal

FEW: Final = 6  # names from which a common beginning shows
MOST: Final = 0.7  # of the names that begin alike
_CODE: Final = re.compile(r"[0-9A-Fa-f]{1,4}")  # a running number: S1_PID_0C_EngineRPM


def own_name(message: Message, signal: Signal) -> str:
    """Return the name without common first parts and a running number behind them.

    A part is set off by an underscore; the last part always stays.
    """
    begins, coded = _beginnings(message)
    own, most = signal.name.split("_"), MOST * len(message.signals)
    place = 0
    while len(message.signals) >= FEW and place < len(own) - 1:
        if begins[tuple(own[: place + 1])] < most:
            break
        place += 1
    if 0 < place < len(own) - 1 and _CODE.fullmatch(own[place]):
        place += coded[tuple(own[:place])] >= most
    return "_".join(own[place:])


@lru_cache(maxsize=64)
def _beginnings(message: Message) -> tuple[Counter[tuple[str, ...]], Counter[tuple[str, ...]]]:
    """Return how many names begin with some parts, and with some parts and a running number."""
    begins: Counter[tuple[str, ...]] = Counter()
    coded: Counter[tuple[str, ...]] = Counter()
    for each in message.signals:
        parts = each.name.split("_")
        for n in range(1, len(parts)):
            begins[tuple(parts[:n])] += 1
            coded[tuple(parts[: n - 1])] += bool(_CODE.fullmatch(parts[n - 1]))
    return begins, coded
