"""Parameter groups of SAE J1939: messages known by their group, whoever sends them.

A 29-bit identifier of J1939 holds priority, parameter group and source address. A database states
one source address, which may be another in the vehicle at hand. Of several senders of one group,
the address that the database states is taken once it is heard, otherwise the first one heard.
Source: SAE J1939-21, section 5.2.
"""

from typing import Final

import numpy as np
from cantools.database.can import Database, Message

from monitor.base.types import BoolArray, IntArray

NULL_ADDRESS: Final = 0xFE  # no ECU sends under it; databases write it for "any"
_BROADCAST_FORMAT: Final = 240  # from this PDU format on, the next byte is part of the group
_BROADCAST_MASK: Final = 0x03FFFF00  # data pages, PDU format and its extension
_DIRECTED_MASK: Final = 0x03FF0000  # the next byte is the destination


def mask_of(can_id: int) -> int:
    """Return the bits of a 29-bit identifier that tell its parameter group.

    >>> hex(mask_of(0x0CF00400)), hex(mask_of(0x0CEA00F9))
    ('0x3ffff00', '0x3ff0000')
    """
    return _BROADCAST_MASK if (can_id >> 16) & 0xFF >= _BROADCAST_FORMAT else _DIRECTED_MASK


def group_of(can_id: int) -> int:
    """Return the parameter group of a 29-bit identifier, as its masked bits."""
    return can_id & mask_of(can_id)


def is_any_source(message: Message, database: Database) -> bool:
    """Return whether a message is known by its parameter group alone.

    It is not if the database has the group twice, which addresses or priorities part.
    """
    states_it = message.protocol == "j1939" or message.frame_id & 0xFF == NULL_ADDRESS
    if not (message.is_extended_frame and states_it):
        return False
    group = group_of(message.frame_id)
    same = [m for m in database.messages if m.is_extended_frame and group_of(m.frame_id) == group]
    return len(same) == 1


class Sender:
    """The source address whose frames of one parameter group are taken.

    address : the one that the database states
    """

    def __init__(self, address: int) -> None:
        self._address = address
        self._heard: int | None = None

    def takes(self, sources: IntArray) -> BoolArray:
        """Return which frames from these source addresses, (n,) in their order, are taken."""
        taken = sources == self._address
        stated = np.flatnonzero(taken)
        first = int(stated[0]) if stated.size else len(sources)
        if first and self._heard is None:
            self._heard = int(sources[0])
        taken[:first] = sources[:first] == self._heard
        if stated.size:
            self._heard = self._address
        return np.asarray(taken)
