"""The part of a signal's name behind the beginning that all names of its message share."""

import re
from collections import Counter
from typing import Final

from cantools.database.can import Message, Signal

FEW: Final = 6  # names from which a common beginning shows
MOST: Final = 0.7  # of the names that begin alike
_CODE: Final = re.compile(r"[0-9A-Fa-f]{1,4}")  # a running number: S1_PID_0C_EngineRPM


def own_name(message: Message, signal: Signal) -> str:
    """Return the name without common first parts and a running number behind them.

    A part is set off by an underscore; the last part always stays.
    """
    parts = [each.name.split("_") for each in message.signals]
    own = signal.name.split("_")
    place = 0
    while len(parts) >= FEW and place < len(own) - 1:
        there = [p[place] for p in parts if len(p) > place + 1 and p[:place] == own[:place]]
        part, count = Counter(there).most_common(1)[0]
        if part != own[place] or count < MOST * len(parts):
            break
        place += 1
    if 0 < place < len(own) - 1 and _CODE.fullmatch(own[place]):
        coded = [p for p in parts if p[:place] == own[:place] and len(p) > place + 1]
        if sum(bool(_CODE.fullmatch(p[place])) for p in coded) >= MOST * len(parts):
            place += 1
    return "_".join(own[place:])
