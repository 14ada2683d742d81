"""The signals of a database that may be a canonical one, with confidence and reasons.

A candidate is a quantity times a unit, a range and the words of its name. A line of the map stands
only without a doubt: a unit or range that leaves a choice, or a word that the quantity does not
explain, which may be a wish, a limit, another machine or a second sensor.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

from cantools.database.can import Database, Message, Signal

from monitor.mapping.quantities import OF_ONE_SENSOR, QUANTITIES, MapQuantity
from monitor.mapping.scaling import scaling_of
from monitor.mapping.words import match, own_name, words_of

SLOW_MS: Final = 1_000_000  # cycle of a message that says none
BY_MESSAGE: Final = 0.85  # confidence that is left where name and message say it together
BY_COMMENT: Final = 0.8  # where only the comment says so
_OTHER_SENSOR: Final = re.compile(
    r"downstream|post|nach|hinter|behind|rear|after|second|\bk?[ck]at(?!e)|catalyst|\b(?:hk|nk|ds|lsf|lsh|sec)\b|"
    r"\b(?:bank|sensor|sonde|[bs]) ?0?[2-9]\b|\bb\d ?s[2-9]\b|\bb[2-9] ?s\d\b|right|links|rechts|"
    r"\bleft|\bh?o2s?(?:\d[2-9]|[2-9]\d?)\b"
)
_UPSTREAM: Final = re.compile(
    r"upstream|pre ?cat|vor ?kat|stromauf|before ?cat|\b(pre|vk|us|vor|front|primary|lsu|b1s1)\b"
)
# of a name or its message: an electric machine, other traffic, comfort
_ELSEWHERE: Final = re.compile(
    r"\bhv|\bhyb|\bev\b|\bmcu\b|\bbms\b|inverter|charger|radar|object|\bobj|\btrack|cruise|\bnav|"
    r"\bgps\b|seat|massage|heater"
)
_PART: Final = re.compile(r"transm|gear|getr|clutch|kuppl|turb|fan|pump")
_ENGINE: Final = re.compile(r"eng|mot|mo\b|\bmd|\b(ecm|ems|dme|cmm)\b")
_ENGLISH: Final = frozenset({"rpm", "speed", "torque"})  # beside which a motor is electric
_PREFIX_LETTERS: Final = 4  # a name may begin with so short an abbreviation of its ECU and "_"
_NO_PREFIX: Final = "max min req des tgt set cmd lim avg low oil egr exh fan pre rel inh raw new"
_BARE_WORDS: Final = (  # of any machine; an unknown word beside them says of which
    "rpm speed spd torque trq tq temp temperature pressure press voltage volt drehzahl n v t u p "
    "trim air flow geschw value val act actual cur raw"
)
_BARE: Final = frozenset(_BARE_WORDS.split())


@dataclass(frozen=True, slots=True)
class MapCandidate:
    """One signal that may be the canonical one: value = factor * signal + offset."""

    name: str  # canonical
    message: Message
    signal: Signal
    confidence: float  # 0 to 1
    factor: float
    offset: float
    why: tuple[str, ...]
    is_phi: bool = False  # the signal is 1 / lambda
    doubts: tuple[str, ...] = ()  # why it stays a comment until a person confirms it
    interval_s: float | None = None  # between two values in the recording, 95 % are shorter
    is_stated: bool = False  # the database says that its sensor is the upstream one
    is_named: bool = True  # nothing in its name, message or comment says another quantity or sensor

    @property
    def place(self) -> str:
        """Return message and signal."""
        return f"{self.message.name}.{self.signal.name}"

    @property
    def rank(self) -> tuple[bool, float]:
        """Return the order of candidates: those without a doubt first, then the likeliest."""
        return bool(self.doubts), -self.confidence

    def judged(
        self, why: str, weight: float = 1.0, plus: float = 0.0, **more: Any
    ) -> "MapCandidate":
        """Return the candidate with one more reason, its confidence times ``weight``."""
        confidence = min(1.0, self.confidence * weight + plus)
        doubts = (*self.doubts, why) if weight < 1.0 else self.doubts
        return replace(self, confidence=confidence, why=(*self.why, why), doubts=doubts, **more)


def ranked(database: Database) -> dict[str, list[MapCandidate]]:
    """Return the candidates of every canonical signal and of the fuel flow, the likeliest first."""
    places = list(_signals(database))
    found: dict[str, list[MapCandidate]] = {}
    for name, quantity in QUANTITIES.items():
        every = (_candidate(name, quantity, *place) for place in places)
        likely = (candidate for candidate in every if candidate is not None)
        found[name] = sorted(likely, key=lambda c: (*c.rank, *_preference(c)))
    return found


def cycle_ms(message: Message) -> float:
    """Return a message's stated cycle time in ms, at most ``SLOW_MS``; a database may say anything.

    A message without one is a slow one.
    """
    stated = message.cycle_time or SLOW_MS
    return float(min(max(stated, 0), SLOW_MS))


def _preference(candidate: MapCandidate) -> tuple[float, float, str]:
    """Return the order of equals: the faster message, the finer steps, then the name."""
    step = abs(float(candidate.signal.scale) * candidate.factor)
    return cycle_ms(candidate.message), step, candidate.place


def _signals(database: Database) -> Iterator[tuple[Message, Signal, tuple[str, ...]]]:
    """Yield the signals that a map can name; two of one name cannot be told apart."""
    last = {message.name: message for message in database.messages}
    for message in last.values():
        names = Counter(signal.name for signal in message.signals)
        for signal in message.signals:
            if not signal.is_multiplexer and signal.length <= 64 and names[signal.name] == 1:
                yield message, signal, words_of(own_name(message, signal))


def _candidate(
    name: str, quantity: MapQuantity, message: Message, signal: Signal, words: tuple[str, ...]
) -> MapCandidate | None:
    """Return the signal as a candidate, None if it is another quantity.

    words : of the signal's own name
    """
    sure, rest = match(quantity.phrases, words)
    why = f"its name says {signal.name}"
    if sure == 0.0 and (quantity.is_flag or name in OF_ONE_SENSOR):
        both, rest = match(quantity.phrases, words + words_of(message.name))
        rest = [word for word in words if word in rest]
        if len(rest) < len(words):
            sure, why = BY_MESSAGE * both, f"its name and message say {message.name} {signal.name}"
    doubts = _doubts(name, quantity, message, signal, words, rest)
    if sure == 0.0 and signal.comment:
        sure = BY_COMMENT * match(quantity.phrases, words_of(signal.comment))[0]
        why, doubts = f"its comment says {_short(signal.comment)}", ["only its comment says so"]
    scaling = scaling_of(name, signal, quantity) if sure > 0.0 else None
    if scaling is None:
        return None
    candidate = MapCandidate(
        name,
        message,
        signal,
        confidence=sure * scaling.weight,
        factor=scaling.factor,
        offset=scaling.offset,
        why=(why, *scaling.why),
        is_phi=scaling.is_phi,
        doubts=(*doubts, *scaling.doubts),
        is_named=not doubts,
    )
    return _of_one_sensor(candidate) if name in OF_ONE_SENSOR else candidate


def _doubts(
    name: str,
    quantity: MapQuantity,
    message: Message,
    signal: Signal,
    words: tuple[str, ...],
    rest: list[str],
) -> list[str]:
    """Return why a name may not say the quantity: by a word that the quantity does not explain."""
    of_message = words_of(message.name)
    if rest and rest[0] == words[0] and _is_device(signal, words, of_message):
        rest = rest[1:]
    odd = [word for word in rest if word not in quantity.also]
    doubts = [f"its name says {odd[0]!r}, too"] if odd else []
    names = (signal.name, message.name)
    other = _ELSEWHERE.search(" ".join((*names, *map(" ".join, map(words_of, names)))).lower())
    if other and name != "sensor_heater_percent":
        doubts.append(f"{message.name}.{signal.name} says {other[0]!r}")
    part = _PART.search(message.name.lower())
    if part and _BARE.issuperset(words):
        doubts.append(f"its message {message.name} says {part[0]!r}")
    if name == "vehicle_speed_km_h" and signal.unit == "m/s" and _BARE.issuperset(words):
        doubts.append("any speed in m/s: perhaps of an object ahead")
    if "motor" in words and _ENGLISH & set(words):
        doubts.append("its name says 'motor', which is an electric one in English")
    if name == "engine_torque_nm" and not _ENGINE.search(" ".join(words + of_message)):
        doubts.append("its name does not say that the torque is the engine's")
    return doubts


def _is_device(signal: Signal, words: tuple[str, ...], of_message: tuple[str, ...]) -> bool:
    """Return whether a name begins with its ECU's abbreviation, which says nothing against it."""
    first, rest = words[0], words[1:]
    is_prefix = len(first) <= _PREFIX_LETTERS and first not in _NO_PREFIX.split()
    is_apart = re.search(rf"{first}\d*_", signal.name.lower()) and not _BARE.issuperset(rest)
    return is_prefix and bool(first in of_message or is_apart)


def _of_one_sensor(candidate: MapCandidate) -> MapCandidate:
    """Return the candidate, doubted if its message or comment is of another sensor."""
    texts = (candidate.message.name, candidate.signal.name, candidate.signal.comment or "")
    reason = elsewhere(texts)
    if reason:
        return candidate.judged(reason, 0.5, is_named=False)
    if any(_UPSTREAM.search(" ".join(words_of(text))) for text in texts):
        return candidate.judged("it is said to be upstream", plus=0.1, is_stated=True)
    if candidate.name == "lambda_measured":
        return candidate.judged("nothing says whether it is upstream: check")
    return candidate


def elsewhere(texts: tuple[str, ...]) -> str:
    """Return why a signal is not of the upstream sensor of bank 1, "" if nothing says so."""
    for text in texts:
        if found := _OTHER_SENSOR.search(" ".join(words_of(text))):
            return f"{_short(text)} says {found[0]!r}: perhaps another sensor or bank"
    return ""


def _short(text: str) -> str:
    """Return a text on one line, of 60 characters at most."""
    line = " ".join(text.split())
    return line if len(line) <= 60 else line[:57] + "..."
