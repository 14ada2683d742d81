"""The signals of a database that may be a canonical one."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.types import FloatArray
from monitor.decode.signal_map import LONGEST_TIMEOUT_S
from monitor.decode.soundness import check_message, check_signal
from monitor.judge.causes.causes import timeout_of
from monitor.mapping.fit import ANY, Description, fit_of
from monitor.mapping.proposal import SignalCandidate
from monitor.mapping.vocabulary import QUANTITIES, VARYING

SLOW_MS: Final = 1_000_000  # cycle of a message that says none, or more
ALL_ONES: Final = frozenset(2.0**bits - 1.0 for bits in range(65))
ENGINE: Final = QUANTITIES.keys() & {"manifold_temperature_degc", *VARYING}  # only an engine's

# values in the database's unit, and how far apart they are in s: 95 % are closer; None of few
Observed = tuple[FloatArray | None, float | None]


def mappable(database: Database) -> Iterator[tuple[str, Message, Signal]]:
    """Yield the signals with which a map can be loaded, behind message and name."""
    for message in database.messages:
        names = Counter(signal.name for signal in message.signals)  # alike: not told apart
        for signal in message.signals:
            try:
                check_message(Path(), message)
                check_signal(Path(), message, signal.name)
            except SignalMapError:
                continue
            if names[signal.name] == 1 and not signal.is_multiplexer and signal.length <= 64:
                yield f"{message.name}.{signal.name}", message, signal


def candidates(
    database: Database, observed: Mapping[str, Observed] | None = None
) -> dict[str, list[SignalCandidate]]:
    """Return the candidates of every canonical signal and of the fuel flow.

    observed : signals of a recording, by message and name; no others are candidates then
    """
    signals = [
        (message, seen[1], _described(message, signal, seen[0]))
        for place, message, signal in mappable(database)
        if (seen := (None, None) if observed is None else observed.get(place))
    ]
    of_engine = (fit_of(name, described) for *_, described in signals for name in ENGINE)
    has_engine = any(fit and not fit.doubt for fit in of_engine)
    found: dict[str, list[SignalCandidate]] = {name: [] for name in QUANTITIES}
    for message, interval_s, described in signals:
        cycle_ms = float(min(max(message.cycle_time or SLOW_MS, 0), SLOW_MS))
        timeout_s = _timeout_s(message, interval_s, cycle_ms)
        own = replace(described, has_engine=has_engine)
        place = {"message": message.name, "signal": own.name}
        is_other = "eng" not in message.name.lower()  # the engine's own message comes first
        for name, each in found.items():
            if fit := fit_of(name, own):
                order = cycle_ms, abs(own.step * fit.factor), is_other, ".".join(place.values())
                way = {"factor": fit.factor, "offset": fit.offset, "timeout_s": timeout_s}
                each.append(SignalCandidate(name, order[-1], fit, place | way, order))
    return found


def _timeout_s(message: Message, interval_s: float | None, cycle_ms: float) -> float:
    """Return how old a value may be, by the recording, else by the stated cycle time."""
    if interval_s is not None:
        return timeout_of(interval_s)
    if cycle_ms < SLOW_MS:  # five cycles
        return round(min(max(5 * cycle_ms / 1000, 0.3), LONGEST_TIMEOUT_S), 3)
    return 3.0 if message.is_multiplexed() else 0.5  # answers to requests come slowly


def _described(message: Message, signal: Signal, values: FloatArray | None) -> Description:
    """Return what a database says about a signal."""
    carried = ANY
    if not signal.is_float:
        least = -(1 << (signal.length - 1)) if signal.is_signed else 0
        raw = least, least + (1 << signal.length) - 1
        low, high = sorted(float(each) * float(signal.scale) + float(signal.offset) for each in raw)
        carried = low, high
    stated = carried
    if signal.minimum is not None and signal.maximum is not None:
        low, high = float(signal.minimum), float(signal.maximum)
        # as an editor fills the range in: that of a number of bits
        is_filler = high in ALL_ONES and low in (0.0, -high, -high - 1.0)
        stated = (low, high) if low < high and not is_filler else carried
    return Description(
        name=signal.name,
        unit=(signal.unit or "").strip(),
        message=message.name,
        comment=signal.comment or "",
        carried=carried,
        stated=stated,
        step=0.0 if signal.is_float else float(signal.scale),
        choices={int(k): str(v).lower() for k, v in (signal.choices or {}).items()},
        values=values,
    )
