"""The plan of a message, made from database and map before its frames come."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from cantools.database.can import Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.types import BoolArray, FloatArray
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.checksum import payload_checksums
from monitor.decode.parameter_groups import mask_of
from monitor.decode.payloads import Bytes, Fields, Numbers
from monitor.decode.raw_values import (
    bit_position,
    last_byte,
    plausible_range,
    raw_limits,
    states_of,
)
from monitor.frames.blocks import EXTENDED

Member = tuple[int, BusChannel]  # channel number, channel
Conditions = tuple[tuple[Signal, tuple[int, ...]], ...]  # multiplexers with the values wanted
_ALL_BITS: Final = 0xFFFFFFFF


def plans_of(bus_map: BusMap, channels: Sequence[str]) -> dict[int, "Plan"]:
    """Return the plans of the messages that carry the channels, by the key of their frames."""
    members: dict[int, list[Member]] = {}
    for index, name in enumerate(channels):
        message = bus_map.channels[name].message
        key = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        members.setdefault(key, []).append((index, bus_map.channels[name]))
    return {key: Plan(key, each) for key, each in members.items()}


class Plan:
    """What is wanted of one message, and what guards it.

    key : of its frames
    members : the wanted channels with their numbers
    Raises SignalMapError if the checksum does not fill a byte.
    """

    def __init__(self, key: int, members: Sequence[Member]) -> None:
        channel = members[0][1]
        message, integrity = channel.message, channel.integrity
        self.message, self.name, self.size = message, message.name, int(message.length)
        self.is_optional = all(each.mapped.is_optional for _, each in members)
        self.any_source, self.address = channel.any_source, key & 0xFF
        mask = mask_of(key & ~EXTENDED) | EXTENDED if self.any_source else _ALL_BITS
        self.match = np.uint32(mask), np.uint32(key & mask)  # bits of a key, and their value
        self.is_multiplexed = message.is_multiplexed()
        self.checksum = _checksum_byte(channel) if integrity.checksum else -1
        self.guard = integrity.algorithm, message.frame_id
        self.counter = message.get_signal_by_name(integrity.counter) if integrity.counter else None
        self.counted = self.counter or channel.signal  # any, if no counter needs to advance
        ranges = {c.range.name: c.range for _, c in members if c.range is not None}
        self.ranges = [(signal, multiplexing(message, signal)) for signal in ranges.values()]
        groups: dict[Conditions, list[Member]] = {}
        for member in members:
            groups.setdefault(multiplexing(message, member[1].signal), []).append(member)
        ordered = sorted(groups.items(), key=lambda item: len(item[0]))
        self.groups = [Group(message, conditions, group) for conditions, group in ordered]
        self.is_plain = len(self.groups) == 1 and not self.groups[0].conditions
        told = [*groups, *(((signal, ()), *conditions) for signal, conditions in self.ranges)]
        self.tested = list({s: None for conditions in told for s, _ in conditions})
        self.tests = Fields((message, signal) for signal in self.tested)


class Checks:
    """The checks of several messages.

    ``which`` are the numbers of the frames' plans, one for all or (n,); ``data`` is (n, n_bytes)
    and zero behind a frame's end.
    """

    def __init__(self, plans: Sequence[Plan]) -> None:
        self._size = np.array([plan.size for plan in plans], dtype=np.uint16)
        # an OBD response may come without padding
        self._least = self._size * np.array([not plan.is_multiplexed for plan in plans])
        self.counters = Fields((plan.message, plan.counted) for plan in plans)
        is_counted = np.array([plan.counter is not None for plan in plans], dtype=np.bool_)
        self.counted = self.counters.mask[:, 0] * is_counted
        width = max((plan.size for plan in plans if plan.checksum >= 0), default=1)
        # what each byte changes in the checksum, itself too: all of a sound payload make ``_sum``
        self._effects = np.zeros((len(plans), width, 256), dtype=np.uint8)
        self._sum, values = np.zeros(len(plans), np.uint8), np.arange(256, dtype=np.uint8)
        for i, plan in enumerate(plans):
            if plan.checksum >= 0:
                single = np.eye(plan.size, dtype=np.uint8)[:, np.newaxis] * values[:, np.newaxis]
                sums = payload_checksums(*plan.guard, single, plan.checksum)
                self._sum[i], self._effects[i, : plan.size] = sums[0, 0], sums ^ sums[0, 0]
                self._effects[i, plan.checksum] = values
        self._places = np.arange(0, self._effects.size, 256).reshape(-1, width).T.copy()

    def fits(self, length: Bytes, which: Numbers | list[int]) -> BoolArray:
        """Return which frames have a right number of bytes, (n,)."""
        fits = (self._least.take(which) <= length) & (length <= self._size.take(which))
        return np.asarray(fits, dtype=np.bool_)

    def holds(self, data: Bytes, which: Numbers | list[int]) -> BoolArray:
        """Return where the checksum holds, or there is none, (n,)."""
        values = data.T[: len(self._places)]
        places = values + self._places[: len(values)].take(which, axis=1)
        found = np.bitwise_xor.reduce(self._effects.take(places), axis=0)
        return np.asarray(found == self._sum.take(which), dtype=np.bool_)


class Group:
    """Channels of a message that come under the same multiplexer values."""

    def __init__(self, message: Message, conditions: Conditions, members: Sequence[Member]) -> None:
        self.conditions, (self.channels, channels) = conditions, zip(*members, strict=True)
        self.n_bytes = max(last_byte(message, channel.signal) for channel in channels) + 1
        self._fields = Fields((message, channel.signal) for channel in channels)
        self._ranged = [(i, channel) for i, channel in enumerate(channels) if channel.range]
        both = [(channel.signal, channel.mapped) for channel in channels]
        pairs = [((own.scale, own.offset), (to.factor, to.offset)) for own, to in both]
        steps = np.array(pairs, dtype=np.float64).transpose(1, 2, 0)[..., np.newaxis]
        steps[:, 1][(steps == [[[1]], [[0]]]).all(axis=1)] = -0.0  # leaves a zero its sign
        self._steps = [(f, o) for f, o in steps if (f != 1).any() or o.any()]
        unlimited = -np.inf, np.inf
        self._raw = [unlimited if c.signal.is_float else raw_limits(c) for c in channels]
        whole = np.iinfo(np.int64)
        raw = [(max(low, whole.min), min(high, whole.max)) for low, high in self._raw]
        self._least, self._most = np.array(raw, dtype=np.int64).T[..., np.newaxis]
        self._has_least = any(channel.signal.is_signed for channel in channels)
        self._states = [(i, own) for i, own in enumerate(map(states_of, channels)) if own]
        limits = np.nan_to_num([plausible_range(channel) for channel in channels])
        self._low, self._high = limits.T[..., np.newaxis]

    def read(self, data: Bytes, most: Mapping[str, FloatArray]) -> tuple[FloatArray, int, int]:
        """Return values in the maps' units, (n_channels, n), NaN not available, inf out of range.

        most : highest values in the database's unit, (n,), 0 where it is the database's, by the
            names of the signals that tell them
        Returns, too, how many are not available and how many out of range.
        """
        raw, odd = self._fields.read(data)
        values, missing = raw.astype(np.float64), raw > self._most
        if self._has_least:
            missing |= raw < self._least
        for i, states in self._states:
            missing[i] |= np.isin(raw[i], states)
        for i, own in odd.items():
            low, high = self._raw[i]
            values[i], missing[i] = own, (own < low) | (own > high)
        for i, channel in self._ranged if most else ():
            told, usual = most[channel.range.name], float(channel.signal.maximum or 1.0)
            values[i] *= np.where(told > 0.0, told / usual, 1.0)
        for factor, offset in self._steps:
            values *= factor
            values += offset
        good = (self._low <= values) & (values <= self._high)
        n_missing = int(np.count_nonzero(missing))
        if n_missing:
            good &= ~missing
        n_bad = good.size - int(np.count_nonzero(good))
        if n_bad:
            values[~good] = np.inf
            values[missing] = np.nan
        return values, n_missing, n_bad - n_missing


def multiplexing(message: Message, signal: Signal) -> Conditions:
    """Return the multiplexer values under which the frame carries the signal, outermost first."""
    if signal.multiplexer_signal is None:
        return ()
    ids, multiplexer = signal.multiplexer_ids, message.get_signal_by_name(signal.multiplexer_signal)
    return (*multiplexing(message, multiplexer), (multiplexer, tuple(ids or ())))


def _checksum_byte(channel: BusChannel) -> int:
    """Return the number of the byte that holds the message's checksum."""
    message = channel.message
    signal: Signal = message.get_signal_by_name(channel.integrity.checksum)
    if signal.length != 8 or bit_position(message, signal) % 8 or signal.is_signed:
        raise SignalMapError(
            f"{channel.map_path}: checksum {message.name}.{signal.name} of {channel.dbc} "
            "must be an unsigned byte of its own"
        )
    return int(signal.start // 8)
