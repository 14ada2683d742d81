"""The evidence of a recording: which candidates and which counters and checksums it bears out."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, FrameBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.checksum import ALGORITHMS, payload_checksum
from monitor.decode.parameter_groups import is_any_source
from monitor.decode.raw_values import bit_position
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.frames.blocks import chosen, frames_of
from monitor.mapping.candidates import MapCandidate
from monitor.mapping.quantities import QUANTITIES, VARYING
from monitor.mapping.words import words_of

CONSIDERED: Final = 8  # candidates of each signal that are compared with the recording
MOST_FRAMES: Final = 2_000_000
FEW: Final = 20  # samples or frames that say nothing
STILL: Final = 1e-9  # range of a signal that never moves
NEARLY_ALL: Final = 0.95  # of the frames in which a counter counts or a checksum holds
MOST_COUNTER_BITS: Final = 8
_COUNTER: Final = re.compile(
    r"alive|rolling|counter|cntr?|botschaft|\bbz\b|\brc\b|zaehler|sequence"
)
_NOT_COUNTER: Final = re.compile(r"error|fault|fehler|event|time|distance|trip|misfire|cycle")
_CHECKSUM: Final = re.compile(r"check ?sum|\bchk|\bcrc|\bcs\b|pruefsumme")


@dataclass(frozen=True, slots=True)
class Protection:
    """The counter and the checksum that seem to protect one message."""

    message: Message
    counter: str
    checksum: str
    algorithm: str = ""  # the one that holds in a recording
    n_frames: int = 0  # in the recording


@dataclass(frozen=True, slots=True)
class SignalSeries:
    """The values of one candidate in canonical units."""

    t_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class ObservedSignal:
    """The candidates' values and their messages' frames in a recording."""

    series: Mapping[tuple[str, str, str], SignalSeries]  # canonical name, message, signal
    payloads: Mapping[str, list[bytes]]  # by message name

    def series_of(self, candidate: MapCandidate) -> SignalSeries | None:
        """Return the values of a candidate, None if it cannot be decoded."""
        return self.series.get((candidate.name, candidate.message.name, candidate.signal.name))

    def frames_of(self, message: Message) -> list[bytes]:
        """Return the payloads of a message in their order."""
        return self.payloads.get(message.name, [])

    def reranked(
        self, ranked: Mapping[str, Sequence[MapCandidate]]
    ) -> dict[str, list[MapCandidate]]:
        """Return the candidates as the recording bears them out, the likeliest first."""
        return {
            name: sorted((_judged(c, self) for c in each[:CONSIDERED]), key=lambda c: c.rank)
            for name, each in ranked.items()
        }

    def protections(self, guarded: Iterable[Protection]) -> list[Protection]:
        """Return the counters and checksums that hold in the recording."""
        return [_borne_out(each, self.frames_of(each.message)) for each in guarded]


def observe(
    blocks: Iterable[FrameBlock],
    ranked: Mapping[str, Sequence[MapCandidate]],
    dbc: Path,
    database: Database,
) -> ObservedSignal:
    """Return the values of the likeliest candidates that can be decoded."""
    candidates: list[MapCandidate] = []
    channels: dict[str, BusChannel] = {}
    for candidate in (c for each in ranked.values() for c in each[:CONSIDERED]):
        key = f"c{len(candidates)}"
        message, signal = candidate.message, candidate.signal
        mapped = MappedSignal(key, message.name, signal.name)
        any_source = is_any_source(message, database)
        channel = BusChannel(
            mapped=mapped,
            message=message,
            signal=signal,
            integrity=Integrity(),
            dbc=dbc,
            map_path=dbc,
            any_source=any_source,
        )
        try:
            _decoder({key: channel}, dbc)
        except (SignalMapError, ValueError, OverflowError):
            continue
        candidates.append(candidate)
        channels[key] = channel
    payloads: dict[str, list[bytes]] = {c.message.name: [] for c in candidates}
    nothing = np.empty(0)
    t_s, values = [[nothing] for _ in candidates], [[nothing] for _ in candidates]
    decoder, first_ns, n = _decoder(channels, dbc), None, 0
    for whole in blocks:
        block = chosen(whole, slice(0, MOST_FRAMES - n))
        if not len(block.t_ns):
            continue
        n += len(block.t_ns)
        first_ns = block.t_ns[0] if first_ns is None else first_ns
        for plan in decoder.plans.values():
            mask, wanted = plan.match
            own = chosen(block, (block.key & mask) == wanted)
            payloads[plan.name] += [frame.data for frame in frames_of(own)]
        for part in decoder.push(block):
            for index, data in zip(part.channels, part.values, strict=True):
                t_s[index].append((block.t_ns[part.rows] - first_ns) / 1e9)
                values[index].append(data)
        if n >= MOST_FRAMES:
            break
    series = {
        (c.name, c.message.name, c.signal.name): SignalSeries(
            np.concatenate(at), _canonical(c, np.concatenate(raw))
        )
        for c, at, raw in zip(candidates, t_s, values, strict=True)
    }
    return ObservedSignal(series, payloads)


def _decoder(channels: dict[str, BusChannel], dbc: Path) -> BlockDecoder:
    return BlockDecoder(BusMap(((dbc, dbc),), channels, {}, tuple(channels)), tuple(channels))


def _canonical(candidate: MapCandidate, raw: FloatArray) -> FloatArray:
    values = raw * candidate.factor + candidate.offset
    with np.errstate(divide="ignore"):
        return 1.0 / values if candidate.is_phi else values


def _judged(candidate: MapCandidate, observed: ObservedSignal) -> MapCandidate:
    """Return the candidate with its confidence after a look at its own values."""
    series = observed.series_of(candidate)
    if series is None or not len(series.values):
        came = series is not None and observed.frames_of(candidate.message)
        lack = "never carries a value" if came else "lacks its message"
        return candidate.judged(f"the recording {lack}", 0.3)
    if len(series.t_s) >= FEW:
        interval_s = float(np.percentile(np.diff(series.t_s), 95.0))
        candidate = replace(candidate, interval_s=interval_s)
    good = series.values[np.isfinite(series.values)]
    low, high = plausible_range(candidate.name)
    inside = good[(good >= low) & (good <= high)]
    if len(inside) < 0.5 * len(series.values):
        seen = f"{good.min():.4g} to {good.max():.4g}" if len(good) else "no valid value"
        return candidate.judged(f"implausible in the recording: {seen}", 0.3)
    seen = f"in the recording {inside.min():.4g} to {inside.max():.4g}"
    if len(inside) < FEW:
        return candidate.judged(seen)
    weight, doubt = _usual(candidate.name, inside)
    return candidate.judged(seen + doubt, weight, 0.0 if doubt else 0.05)


def _usual(name: str, values: FloatArray) -> tuple[float, str]:
    """Return the confidence that is left when the values are unusual, and the doubt."""
    if name in VARYING and np.ptp(values) < STILL:
        return 0.5, ": it never moves"
    if name not in QUANTITIES or name.endswith("_degc"):
        return 1.0, ""
    low, high = QUANTITIES[name].typical
    if name.startswith("lambda_"):
        middle = float(np.median(values))
        usual = 0.7 * low <= middle <= 1.5 * high
        return (1.0, "") if usual else (0.5, f": its median is {middle:.4g}")
    return (0.6, ": unusual") if values.max() < low or values.min() > high else (1.0, "")


def protections(messages: Iterable[Message]) -> list[Protection]:
    """Return the counters and checksums of the messages by their signals' names."""
    found = []
    for message in sorted({m.name: m for m in messages}.values(), key=lambda m: m.frame_id):
        if message.is_multiplexed() or message.length > 8:
            continue
        counter, checksum = _named(message, _is_counter), _named(message, _is_checksum)
        if counter or checksum:
            found.append(Protection(message, counter, checksum))
    return found


def _named(message: Message, is_it: Callable[[Signal, str], bool]) -> str:
    unsigned = (signal for signal in message.signals if not signal.is_signed)
    return next((s.name for s in unsigned if is_it(s, " ".join(words_of(s.name)))), "")


def _is_counter(signal: Signal, name: str) -> bool:
    fits = 2 <= signal.length <= MOST_COUNTER_BITS
    return fits and bool(_COUNTER.search(name)) and not _NOT_COUNTER.search(name)


def _is_checksum(signal: Signal, name: str) -> bool:
    return signal.length == 8 and bool(_CHECKSUM.search(name))


def _borne_out(each: Protection, payloads: list[bytes]) -> Protection:
    """Return the parts of a protection that hold in a message's frames."""
    message = each.message
    frames = [data for data in payloads if len(data) == message.length]
    enough = len(frames) >= FEW
    counter = each.counter if enough and _counts(message, each.counter, frames) else ""
    algorithm = _algorithm(message, each.checksum, frames) if enough else ""
    checksum = each.checksum if algorithm else ""
    return replace(
        each, counter=counter, checksum=checksum, algorithm=algorithm, n_frames=len(frames)
    )


def _counts(message: Message, name: str, frames: list[bytes]) -> bool:
    """Return whether the signal goes up by one, wrapping round, in nearly all frames."""
    if not name:
        return False
    signal = message.get_signal_by_name(name)
    top, shift = 1 << signal.length, bit_position(message, signal)
    little = signal.byte_order == "little_endian"
    raw = [int.from_bytes(data, "little" if little else "big") >> shift for data in frames]
    steps = [(b - a) % top == 1 for a, b in pairwise(raw)]
    return sum(steps) >= NEARLY_ALL * len(steps)


def _algorithm(message: Message, name: str, frames: list[bytes]) -> str:
    """Return the algorithm by which the checksum holds in nearly all frames, "" if none."""
    if not name:
        return ""
    signal = message.get_signal_by_name(name)
    if bit_position(message, signal) % 8:
        return ""
    place, least = signal.start // 8, NEARLY_ALL * len(frames)
    for algorithm in ALGORITHMS:
        sums = (payload_checksum(algorithm, message.frame_id, data, place) for data in frames)
        if sum(a == data[place] for a, data in zip(sums, frames, strict=True)) >= least:
            return algorithm
    return ""
