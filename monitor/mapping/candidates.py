"""The signals of a database that may be a canonical one, the likeliest first."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from cantools.database.can import Database, Message, Signal

from monitor.base.types import FloatArray
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
        fit = fit_of(self.name, described) or self.fit.doubted(
            "implausible in the recording", OTHER_NAME
        )
        return replace(self, described=described, fit=fit, interval_s=interval_s)


Ranked = Mapping[str, Sequence[MapCandidate]]  # by canonical name, the likeliest first


def ranked(database: Database) -> dict[str, list[MapCandidate]]:
    """Return the candidates of every canonical signal and of the fuel flow, the likeliest first."""
    messages = {message.name: message for message in database.messages}
    found: dict[str, list[MapCandidate]] = {name: [] for name in QUANTITIES}
    for message in messages.values():
        names = Counter(signal.name for signal in message.signals)  # alike: not told apart
        for signal in message.signals:
            if signal.is_multiplexer or signal.length > 64 or names[signal.name] > 1:
                continue
            described = described_by(message, signal)
            for name, candidates in found.items():
                if fit := fit_of(name, described):
                    candidates.append(MapCandidate(name, message, signal, described, fit))
    return {name: sorted(each, key=lambda c: c.rank) for name, each in found.items()}


def cycle_ms(message: Message) -> float:
    """Return a message's stated cycle time in ms, at most ``SLOW_MS``; a database may say anything.

    A message without one is a slow one.
    """
    return float(min(max(message.cycle_time or SLOW_MS, 0), SLOW_MS))


def described_by(message: Message, signal: Signal) -> Description:
    """Return what a database says about a signal."""
    bits, carried = signal.length, ANY
    if not signal.is_float:
        least = -(1 << (bits - 1)) if signal.is_signed else 0
        raw = least, least + (1 << bits) - 1
        low, high = sorted(float(each) * float(signal.scale) + float(signal.offset) for each in raw)
        carried = low, high
    stated = carried
    if signal.minimum is not None and signal.maximum is not None:
        low, high = float(signal.minimum), float(signal.maximum)
        of_bits = high.is_integer() and (int(high) + 1).bit_count() == 1  # as an editor fills it
        is_filler = of_bits and low in (0.0, -high, -high - 1.0)
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
