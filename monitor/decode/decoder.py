"""Frames to values: one decoder per message, its source generated once from the DBC.

Checks, in this order: length, checksum, counter, multiplexer, not available, plausible range. A
frame that fails one of the first three is counted and dropped; a value that fails one of the last
two is counted and marked. Nothing here is ever fatal.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

from monitor.base.types import Frame, Update
from monitor.decode.bus_map import BusMap
from monitor.decode.decoder_source import Decode, Member, Reason, build_decoder
from monitor.decode.open_tick import Received
from monitor.decode.parameter_groups import Sender, group_of, mask_of

EXTENDED = 1 << 31  # set in the key of a 29-bit identifier


@dataclass(frozen=True, slots=True)
class MessageCounters:
    """Counts of the frames of one message."""

    received: int = 0
    length: int = 0  # dropped: wrong number of bytes
    checksum: int = 0  # dropped: checksum does not hold
    stuck: int = 0  # dropped: counter did not advance
    other: int = 0  # not used: multiplexed to signals nobody asked for
    lost: int = 0  # frames that the counter says are missing
    not_available: int = 0  # values that the sender marks as not available
    out_of_range: int = 0  # values outside the plausible range

    @property
    def used(self) -> int:
        """Return the number of frames whose values were used."""
        return self.received - self.length - self.checksum - self.stuck - self.other


class Decoder:
    """Decodes the frames that carry ``names``; everything else is skipped and counted.

    bus_map : what the bus provides
    names : canonical signals wanted, any of ``bus_map.names`` and ``bus_map.optional``
    Raises SignalMapError if a name is not provided or a protected signal does not fit.
    """

    def __init__(self, bus_map: BusMap, names: Sequence[str]) -> None:
        self.names, self.channels, self.derived, self.timeouts_ns = bus_map.wanted(names)
        self.unmapped = 0  # frames under identifiers nobody asked for
        self.received = Received(len(self.channels))  # what ``receive`` adds to
        self._handlers: dict[int, Decode] = {}
        self._groups: dict[int, tuple[Sender, Decode]] = {}  # by parameter group
        self._resets: list[Callable[[], None]] = []
        self._counts: dict[str, list[int]] = {}
        self._optional: set[str] = set()  # messages that not every vehicle sends
        for key, members in by_message(bus_map, self.channels).items():
            counts = [0] * len(Reason)
            decode, reset = build_decoder(members, counts, self.received)
            if members[0][1].any_source:
                sender = Sender(key & 0xFF)
                self._groups[group_of(key & ~EXTENDED)] = sender, decode
                self._resets.append(sender.reset)
            else:
                self._handlers[key] = decode
            self._resets.append(reset)
            self._counts[members[0][1].message.name] = counts
            if is_optional(members):
                self._optional.add(members[0][1].message.name)

    def receive(self, frame: Frame) -> bool:
        """Add the frame's values to ``received``.

        Returns False if it says nothing that is wanted or is not sound.
        """
        t_ns, can_id, is_extended, data = frame
        handler = self._handlers.get(can_id | EXTENDED if is_extended else can_id)
        if handler is None:
            return self._receive_group(frame) if self._groups and is_extended else self._pass()
        return handler(data, t_ns)

    def _receive_group(self, frame: Frame) -> bool:
        """Add the values of a frame of a parameter group."""
        t_ns, can_id, _, data = frame
        sender, decode = self._groups.get(group_of(can_id), (None, None))
        if sender is None or decode is None or not sender.takes(can_id & 0xFF):
            return self._pass()
        return decode(data, t_ns)

    def _pass(self) -> bool:
        self.unmapped += 1
        return False

    def push(self, frame: Frame) -> Update | None:
        """Return the values of one frame by itself, with the counters but without ``received``.

        Returns None if it says nothing that is wanted or is not sound.
        """
        before = self.received.copy()
        self.received.clear()
        update = self.received.update() if self.receive(frame) else None
        self.received.restore(before)
        return update

    def reset(self) -> None:
        """Forget the last counters of all messages; the statistics stay."""
        for reset in self._resets:
            reset()

    @property
    def identifiers(self) -> tuple[tuple[int, bool], ...]:
        """Return (identifier, is_extended) of every needed message, for filters on the bus."""
        return tuple((key & (EXTENDED - 1), key >= EXTENDED) for key in self._handlers)

    @property
    def groups(self) -> tuple[tuple[int, int], ...]:
        """Return (parameter group, its mask) of every needed message that anyone may send."""
        return tuple((group, mask_of(group)) for group in self._groups)

    @property
    def counters(self) -> dict[str, MessageCounters]:
        """Return the counters by message name, of optional messages only if they came."""
        counters = {name: counters_of(counts) for name, counts in self._counts.items()}
        return {name: c for name, c in counters.items() if c.received or name not in self._optional}


def by_message(bus_map: BusMap, channels: Sequence[str]) -> dict[int, list[Member]]:
    """Return the numbered channels of each message, by the key of its frames."""
    groups: dict[int, list[Member]] = {}
    for index, name in enumerate(channels):
        channel = bus_map.channels[name]
        message = channel.message
        key = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        groups.setdefault(key, []).append((index, channel))
    return groups


def is_optional(members: Sequence[Member]) -> bool:
    """Return whether a message carries optional signals alone."""
    return all(channel.mapped.is_optional for _, channel in members)


def counters_of(counts: Sequence[int]) -> MessageCounters:
    """Return a message's counters from its counts, one per Reason."""
    return MessageCounters(*(counts[Reason[each.name.upper()]] for each in fields(MessageCounters)))
