"""Checks proposals with a recording: is it there, plausible, does it move, and with what."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import SignalMapError
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, Frame
from monitor.decode.bus_map import BusMap, Channel
from monitor.decode.decoder import Decoder
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.mapping.candidate import Candidate
from monitor.mapping.meanings import MEANINGS, TOGETHER, VARYING

CONSIDERED: Final = 8  # candidates of each signal that are looked at
GRID_S: Final = 0.5  # on which signals are compared
MOST_FRAMES: Final = 2_000_000
FEW: Final = 20  # samples that say nothing
STILL: Final = 1e-9  # range of a signal that never moves
RELATED: Final = 0.2  # correlation of signals that rise and fall together


@dataclass(frozen=True, slots=True)
class Series:
    """The values of one candidate in canonical units."""

    t_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Observed:
    """What a recording shows of all candidates."""

    series: Mapping[tuple[str, str, str], Series]  # canonical name, message, signal
    payloads: Mapping[tuple[int, bool], list[bytes]]
    frames: int


def observe(
    frames: Iterable[Frame], found: Mapping[str, Sequence[Candidate]], dbc: Path
) -> Observed:
    """Return the series of the candidates; those that cannot be decoded are left out."""
    keys: list[tuple[str, Candidate]] = []
    channels: dict[str, Channel] = {}
    for name, each in found.items():
        for candidate in each[:CONSIDERED]:
            key = f"c{len(keys)}"
            channel = Channel(
                MappedSignal(key, candidate.message.name, candidate.signal.name),
                candidate.message,
                candidate.signal,
                Integrity(),
                dbc,
                dbc,
            )
            if _decodes(key, channel, dbc):
                keys.append((name, candidate))
                channels[key] = channel
    payloads: dict[tuple[int, bool], list[bytes]] = {
        (c.message.frame_id, c.message.is_extended_frame): [] for c in channels.values()
    }
    values: list[tuple[list[float], list[float]]] = [([], []) for _ in keys]
    decoder = Decoder(BusMap(((dbc, dbc),), channels, {}, tuple(channels)), tuple(channels))
    n, first_ns = 0, None
    for frame in frames:
        n += 1
        first_ns = frame.t_ns if first_ns is None else first_ns
        if (kept := payloads.get((frame.can_id, frame.is_extended))) is not None:
            kept.append(frame.data)
        update = decoder.push(frame)
        if update is not None:
            at_s = (frame.t_ns - first_ns) / 1e9
            for index, value in zip(*update, strict=True):
                values[index][0].append(at_s)
                values[index][1].append(value)
        if n >= MOST_FRAMES:
            break
    series = {}
    for (name, candidate), (t_s, raw) in zip(keys, values, strict=True):
        scaled = np.array(raw) * candidate.factor + candidate.offset
        if candidate.is_phi:
            with np.errstate(divide="ignore"):
                scaled = 1.0 / scaled
        series[(name, candidate.message.name, candidate.signal.name)] = Series(
            np.array(t_s), scaled
        )
    return Observed(series, payloads, n)


def _decodes(key: str, channel: Channel, dbc: Path) -> bool:
    try:
        Decoder(BusMap(((dbc, dbc),), {key: channel}, {}, (key,)), (key,))
    except (SignalMapError, ValueError, OverflowError):
        return False
    return True


def reranked(
    found: Mapping[str, Sequence[Candidate]], observed: Observed
) -> dict[str, list[Candidate]]:
    """Return the candidates with what the recording says of each, the likeliest first."""
    judged = {
        name: [_judged(name, c, observed) for c in each[:CONSIDERED]]
        for name, each in found.items()
    }
    best = {
        name: max(each, key=lambda c: (not c.blocked, c.confidence))
        for name, each in judged.items()
        if each
    }
    for name, each in judged.items():
        together = [b if a == name else a for a, b in TOGETHER if name in (a, b)]
        partners = [best[other] for other in together if other in best]
        judged[name] = sorted(
            (_compared(c, name, partners, observed) for c in each),
            key=lambda c: (bool(c.blocked), -c.confidence),
        )
    return judged


def _judged(name: str, candidate: Candidate, observed: Observed) -> Candidate:
    """Return the candidate with its confidence after a look at its own values."""
    series = observed.series.get((name, candidate.message.name, candidate.signal.name))
    if series is None or not len(series.values):
        key = (candidate.message.frame_id, candidate.message.is_extended_frame)
        came = series is not None and observed.payloads.get(key)
        what = "never carries a value" if came else "lacks its message"
        return _weighed(candidate, 0.3, f"the recording {what}")
    good = series.values[np.isfinite(series.values)]
    low, high = plausible_range(name)
    inside = good[(good >= low) & (good <= high)]
    if len(inside) < 0.5 * len(series.values):
        seen = f"{_n(good.min())} to {_n(good.max())}" if len(good) else "no valid value"
        return _weighed(candidate, 0.3, f"implausible in the recording: {seen}")
    seen = f"in the recording {_n(inside.min())} to {_n(inside.max())}"
    if len(inside) < FEW:
        return replace(candidate, why=(*candidate.why, seen))
    weight, said = _usual(name, inside)
    return _weighed(candidate, weight, seen + said, 0.05 if weight == 1.0 else 0.0)


def _usual(name: str, values: FloatArray) -> tuple[float, str]:
    """Return what is left of the confidence when the values are unusual, and why."""
    if name in VARYING and np.ptp(values) < STILL:
        return 0.5, ": it never moves"
    if name not in MEANINGS or name.endswith("_degc"):
        return 1.0, ""
    low, high = MEANINGS[name].typical
    if name.startswith("lambda_"):
        middle = float(np.median(values))
        usual = 0.7 * low <= middle <= 1.5 * high
        return (1.0, "") if usual else (0.5, f": its median is {_n(middle)}")
    return (0.6, ": unusual") if values.max() < low or values.min() > high else (1.0, "")


def _weighed(candidate: Candidate, weight: float, why: str, plus: float = 0.0) -> Candidate:
    confidence = min(1.0, candidate.confidence * weight + plus)
    return replace(candidate, confidence=confidence, why=(*candidate.why, why))


def _compared(
    candidate: Candidate, name: str, partners: Sequence[Candidate], observed: Observed
) -> Candidate:
    """Return the candidate with its confidence after a look at what it should move with."""
    own = observed.series.get((name, candidate.message.name, candidate.signal.name))
    for partner in partners:
        other = observed.series.get((partner.name, partner.message.name, partner.signal.name))
        together = _correlation(own, other) if own and other else None
        if together is None or partner.confidence < 0.5:
            continue
        said = f"moves with {partner.name} (correlation {together:+.2f})"
        if together < -RELATED:
            candidate = _weighed(candidate, 0.7, said.replace("moves", "does not move"))
        elif together > RELATED:
            candidate = _weighed(candidate, 1.0, said, 0.03)
    return candidate


def _correlation(a: Series, b: Series) -> float | None:
    """Return the correlation of two series on one grid, None if they do not tell."""
    if min(len(a.values), len(b.values)) < FEW:
        return None
    start, end = max(a.t_s[0], b.t_s[0]), min(a.t_s[-1], b.t_s[-1])
    if end - start < 10.0:
        return None
    grid = np.arange(start, end, GRID_S)
    x, y = (np.interp(grid, s.t_s, np.nan_to_num(s.values, posinf=0.0, neginf=0.0)) for s in (a, b))
    if np.ptp(x) < STILL or np.ptp(y) < STILL:
        return None
    return float(np.corrcoef(x, y)[0, 1])


def _n(value: float) -> str:
    return f"{value:.4g}"
