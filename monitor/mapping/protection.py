"""Alive counters and checksums: what they are called, and whether a recording bears them out."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from cantools.database.can import Message, Signal

from monitor.decode.checksum import ALGORITHMS, payload_checksum
from monitor.decode.raw_values import bit_position
from monitor.mapping.toml_text import quoted
from monitor.mapping.words import words_of

_COUNTER: Final = re.compile(
    r"alive|rolling|counter|cntr?|botschaft|\bbz\b|\brc\b|zaehler|sequence"
)
_NOT_COUNTER: Final = re.compile(r"error|fault|fehler|event|time|distance|trip|misfire|cycle")
_CHECKSUM: Final = re.compile(r"check ?sum|\bchk|\bcrc|\bcs\b|pruefsumme")
MOST_COUNTER_BITS: Final = 8


@dataclass(frozen=True, slots=True)
class Guarded:
    """What seems to protect one message."""

    message: Message
    counter: str = ""
    checksum: str = ""
    algorithm: str = ""  # the one that holds in a recording
    seen: int = 0  # frames in the recording


@dataclass(frozen=True, slots=True)
class Protection:
    """What seems to protect the messages, by their names."""

    messages: tuple[Guarded, ...] = field(default=())

    def lines(self) -> list[str]:
        """Return the tables of the map, commented out where no recording bears them out."""
        return [line for each in self.messages for line in _lines(each)]


def protection(messages: Iterable[Message]) -> Protection:
    """Return what the names say protects these messages."""
    found = []
    for message in sorted({m.name: m for m in messages}.values(), key=lambda m: m.frame_id):
        if message.is_multiplexed() or message.length > 8:
            continue
        counter = next((s.name for s in message.signals if _is_counter(s)), "")
        checksum = next((s.name for s in message.signals if _is_checksum(s)), "")
        if counter or checksum:
            found.append(Guarded(message, counter, checksum))
    return Protection(tuple(found))


def borne_out(guesses: Protection, payloads: Mapping[tuple[int, bool], list[bytes]]) -> Protection:
    """Return what holds in the frames of a recording; what does not is left out.

    payloads : of each message by identifier and whether it has 29 bits, in their order
    """
    kept = []
    for each in guesses.messages:
        message = each.message
        frames = [
            data
            for data in payloads.get((message.frame_id, message.is_extended_frame), [])
            if len(data) == message.length
        ]
        counter = each.counter if _counts(message, each.counter, frames) else ""
        algorithm = _algorithm(message, each.checksum, frames)
        kept.append(
            Guarded(message, counter, each.checksum if algorithm else "", algorithm, len(frames))
        )
    return Protection(tuple(kept))


def _is_counter(signal: Signal) -> bool:
    name = " ".join(words_of(signal.name))
    return (
        2 <= signal.length <= MOST_COUNTER_BITS
        and not signal.is_signed
        and _COUNTER.search(name) is not None
        and _NOT_COUNTER.search(name) is None
    )


def _is_checksum(signal: Signal) -> bool:
    name = " ".join(words_of(signal.name))
    return signal.length == 8 and not signal.is_signed and _CHECKSUM.search(name) is not None


def _raw(message: Message, signal: Signal, data: bytes) -> int:
    order = "little" if signal.byte_order == "little_endian" else "big"
    value = int.from_bytes(data, order)  # type: ignore[arg-type]
    return value >> bit_position(message, signal) & ((1 << signal.length) - 1)


def _counts(message: Message, name: str, frames: list[bytes]) -> bool:
    """Return whether the signal goes up by one, wrapping round, in nearly all frames."""
    if not name or len(frames) < 20:
        return False
    signal = message.get_signal_by_name(name)
    raw = [_raw(message, signal, data) for data in frames]
    top = 1 << signal.length
    steps = [(b - a) % top == 1 for a, b in pairwise(raw)]
    return sum(steps) >= 0.95 * len(steps)


def _algorithm(message: Message, name: str, frames: list[bytes]) -> str:
    """Return the algorithm by which the checksum holds in nearly all frames, "" if none."""
    if not name or len(frames) < 20:
        return ""
    signal = message.get_signal_by_name(name)
    if bit_position(message, signal) % 8:
        return ""
    place = signal.start // 8
    for algorithm in ALGORITHMS:
        held = sum(
            payload_checksum(algorithm, message.frame_id, data, place) == data[place]
            for data in frames
        )
        if held >= 0.95 * len(frames):
            return algorithm
    return ""


def _lines(each: Guarded) -> Iterator[str]:
    name = quoted(each.message.name)
    keys = []
    if each.counter:
        keys.append(f"counter = {quoted(each.counter)}")
    if each.checksum:
        keys.append(f"checksum = {quoted(each.checksum)}")
        keys.append(f'algorithm = "{each.algorithm or next(iter(ALGORITHMS))}"')
    if each.seen:
        if keys:
            yield f"# holds in {each.seen} frames of the recording"
            yield from (f"[messages.{name}]", *keys, "")
        return
    yield "# by its names; check with a recording (--log), then remove the #"
    yield from (f"# {line}" for line in (f"[messages.{name}]", *keys))
    yield ""
