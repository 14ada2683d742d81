"""The signals of a database that may be a canonical one, the likeliest first."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.types import FloatArray
from monitor.decode.soundness import check_message, check_signal
from monitor.mapping.fit import ANY, OTHER_NAME, Description, QuantityFit, fit_of
from monitor.mapping.quantities import QUANTITIES

SLOW_MS: Final = 1_000_000  # cycle of a message that says none


@dataclass(frozen=True, slots=True)
class MapCandidate:
    """One signal that may be the canonical one."""

    name: str  # canonical
    message: Message
    signal: Signal
    described: Description
    fit: QuantityFit
    interval_s: float | None = None  # between two values in the recording, 95 % are shorter

    @property
    def place(self) -> str:
        """Return message and signal."""
        return f"{self.message.name}.{self.signal.name}"

    @property
    def rank(self) -> tuple[bool, float, float, float, bool, str]:
        """Return the order: no doubt, likely, a fast message, fine steps, the engine's own."""
        fit, own = self.fit, "eng" in self.message.name.lower()
        step = abs(self.described.step * fit.factor)
        return bool(fit.doubts), -fit.confidence, cycle_ms(self.message), step, not own, self.place

    def seen(self, values: FloatArray, interval_s: float | None) -> "MapCandidate":
        """Return the candidate as its own values bear it out."""
        described = replace(self.described, values=values)
        doubted = self.fit.doubted("implausible in the recording", OTHER_NAME)
        fit = fit_of(self.name, described) or doubted
        return replace(self, described=described, fit=fit, interval_s=interval_s)


Ranked = Mapping[str, Sequence[MapCandidate]]  # by canonical name, the likeliest first


def ranked(database: Database) -> dict[str, list[MapCandidate]]:
    """Return the candidates of every canonical signal and of the fuel flow, the likeliest first."""
    found: dict[str, list[MapCandidate]] = {name: [] for name in QUANTITIES}
    for message in database.messages:
        names = Counter(signal.name for signal in message.signals)  # alike: not told apart
        for signal in message.signals:
            if names[signal.name] == 1 and _can_be_mapped(message, signal):
                described = described_by(message, signal)
                for name, candidates in found.items():
                    if fit := fit_of(name, described):
                        candidates.append(MapCandidate(name, message, signal, described, fit))
    return {name: sorted(each, key=lambda c: c.rank) for name, each in found.items()}


def _can_be_mapped(message: Message, signal: Signal) -> bool:
    """Return whether a map with the signal can be loaded."""
    try:
        check_message(Path(), message)
        check_signal(Path(), message, signal.name)
    except SignalMapError:
        return False
    return not signal.is_multiplexer and signal.length <= 64


def cycle_ms(message: Message) -> float:
    """Return a message's stated cycle time in ms, at most ``SLOW_MS``; a database may say anything.

    A message without one is a slow one.
    """
    return float(min(max(message.cycle_time or SLOW_MS, 0), SLOW_MS))


def described_by(message: Message, signal: Signal) -> Description:
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
        is_filler = (  # as an editor fills the range in: that of a number of bits
            high.is_integer()
            and (int(high) + 1).bit_count() == 1
            and low in (0.0, -high, -high - 1.0)
        )
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
    )
