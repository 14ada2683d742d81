"""The signals of a database that may be a canonical one, with confidence and reasons."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from cantools.database.can import Database, Message, Signal

from monitor.mapping.agreement import doubts
from monitor.mapping.meanings import FUEL_FLOW, MEANINGS, OF_ONE_SENSOR, Meaning
from monitor.mapping.own_names import own_name
from monitor.mapping.scaling import scaling_of
from monitor.mapping.vocabulary import match, words_of

FUEL_FLOW_NAME: Final = "fuel_flow_kg_h"
SLOW_MS: Final = 1_000_000  # cycle of a message that says none
_DOWNSTREAM: Final = re.compile(
    r"downstream|post_?cat|nach_?kat|hinter|after_?cat|behind|rear|second|sekund|stromab|"
    r"\b(post|nk|hk|ds|nach|after|aft|tail|lsh|lsf|sec|binary|binaer|narrow\w*|nernst|switching)\b"
)
_UPSTREAM: Final = re.compile(
    r"upstream|pre_?cat|vor_?kat|stromauf|before_?cat|\b(pre|vk|us|vor|front|primary|lsu|b1s1)\b"
)
_CATALYST: Final = re.compile(r"\b(k|c)at\b|kataly|catalyst")
_BANK: Final = re.compile(r"\b(left|right|links|rechts|li|re|lh|rh|bank [a-z]|odd|even)\b")
_SENSOR_NUMBER: Final = re.compile(r"(?:h?o2s|b|s|bank|sensor|bk|sens|cyl|zyl)(\d+)")
_NUMBERED: Final = re.compile(
    r"h?o2s?|lambda\w*|lam\w*|afr|uego|lsu|sensor|sonde|bank|trim|stft|wideband|wbo?|ego|frm?|"
    r"cylinder|cyl|b|s"
)

Place = tuple[Message, Signal, tuple[str, ...]]  # a signal, and the words of its own name


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
    blocked: str = ""  # the reason why it is never proposed, only shown
    doubts: tuple[str, ...] = ()  # why it stays a comment until a person confirms it
    interval_s: float | None = None  # between two values in the recording, 95 % are shorter
    is_stated: bool = False  # the database says that its sensor is the upstream one

    @property
    def place(self) -> str:
        """Return message and signal."""
        return f"{self.message.name}.{self.signal.name}"

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Return the order of candidates: those without a doubt first, then the likeliest."""
        return bool(self.blocked), bool(self.doubts), -self.confidence

    def judged(
        self, why: str, weight: float = 1.0, plus: float = 0.0, **more: Any
    ) -> "MapCandidate":
        """Return the candidate with one more reason, its confidence times ``weight``."""
        confidence = min(1.0, self.confidence * weight + plus)
        doubts = (*self.doubts, why) if weight < 1.0 else self.doubts
        return replace(self, confidence=confidence, why=(*self.why, why), doubts=doubts, **more)


def ranked(database: Database) -> dict[str, list[MapCandidate]]:
    """Return the candidates of every canonical signal and of the fuel flow, the likeliest first."""
    meanings = MEANINGS | {FUEL_FLOW_NAME: FUEL_FLOW}
    signals = [(*place, words_of(own_name(*place))) for place in _signals(database)]
    return {name: _candidates(signals, name, meanings[name]) for name in meanings}


def _candidates(signals: Sequence[Place], name: str, meaning: Meaning) -> list[MapCandidate]:
    every = (_candidate(name, meaning, *place) for place in signals)
    likely = [candidate for candidate in every if candidate is not None]
    return sorted(likely, key=lambda c: (*c.rank, *_preference(c)))


def cycle_ms(message: Message) -> float:
    """Return a message's stated cycle time in ms, at most ``SLOW_MS``; a database may say anything.

    A message without one is a slow one.
    """
    stated = message.cycle_time or SLOW_MS
    return float(min(max(stated, 0), SLOW_MS))


def _preference(candidate: MapCandidate) -> tuple[float, float, str]:
    """Return the order of equals: the faster message, the finer steps, then the name."""
    return (
        cycle_ms(candidate.message),
        abs(float(candidate.signal.scale) * candidate.factor),
        candidate.place,
    )


def _signals(database: Database) -> Iterator[tuple[Message, Signal]]:
    """Yield the signals that a map can name; two of one name cannot be told apart."""
    last = {message.name: message for message in database.messages}
    for message in last.values():
        names = Counter(signal.name for signal in message.signals)
        for signal in message.signals:
            if not signal.is_multiplexer and signal.length <= 64 and names[signal.name] == 1:
                yield message, signal


def _candidate(
    name: str, meaning: Meaning, message: Message, signal: Signal, words: tuple[str, ...]
) -> MapCandidate | None:
    """Return the signal as a candidate, None if it is another quantity.

    words : of the signal's own name
    """
    sure, why = _name(meaning, message, signal, words)
    scaling = scaling_of(name, signal, meaning) if sure > 0.0 else None
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
        doubts=(*doubts(name, meaning, message, signal), *scaling.doubts),
    )
    return _of_one_sensor(candidate) if name in OF_ONE_SENSOR else _numbered(candidate)


def _name(
    meaning: Meaning, message: Message, signal: Signal, words: tuple[str, ...]
) -> tuple[float, str]:
    """Return how sure names and comment are, and the one that says most."""
    of_message, comment = words_of(message.name), words_of(signal.comment or "")
    sure, why = match(meaning.phrases, words), f"its name says {signal.name}"
    both = 0.85 * match(meaning.phrases, words + of_message)
    told = 0.8 * match(meaning.phrases, comment)
    if max(sure, both, told) == 0.0 or is_other(meaning, words):
        return 0.0, ""
    if both > sure and not is_other(meaning, of_message):
        sure, why = both, f"its name and its message say {message.name} {signal.name}"
    if told > sure and not is_other(meaning, comment):
        sure, why = told, f"its comment says {_short(signal.comment or '')}"
    return sure, why


def is_other(meaning: Meaning, words: tuple[str, ...]) -> bool:
    """Return whether the words name another quantity, a limit or a state."""
    if meaning.never.intersection(words):
        return True
    if any(len(stem) > 4 and stem in word for stem in meaning.never for word in words):
        return True
    if meaning.is_flag or (
        meaning is MEANINGS["lambda_target"] and not {"max", "min", "limit"}.intersection(words)
    ):
        return False
    name = "_".join(words) + "_"
    return any(stem in words if len(stem) < 5 else stem in name for stem in meaning.others)


def _numbered(candidate: MapCandidate) -> MapCandidate:
    """Return the candidate, less sure if its name says that it is a second one."""
    numbers = [
        w
        for w in words_of(own_name(candidate.message, candidate.signal))
        if w.isdigit() and int(w) > 1
    ]
    if not numbers:
        return candidate
    return candidate.judged(f"its name ends in {numbers[0]}: perhaps a second one", 0.75)


def _of_one_sensor(candidate: MapCandidate) -> MapCandidate:
    """Return the candidate, blocked if it belongs to another sensor than the upstream one."""
    own = own_name(candidate.message, candidate.signal)
    texts = (own, candidate.message.name, candidate.signal.comment or "")
    reason = elsewhere(texts)
    if reason:
        return replace(candidate, blocked=reason)
    if any(_UPSTREAM.search(_spaced(text)) for text in texts):
        return candidate.judged("it is said to be upstream", plus=0.1, is_stated=True)
    if candidate.name == "lambda_measured":
        return candidate.judged("nothing says whether it is upstream: check")
    return candidate


def elsewhere(texts: tuple[str, ...]) -> str:
    """Return why a signal is not of the upstream sensor of bank 1, "" if nothing says so."""
    for text in texts:
        spaced = _spaced(text)
        down, bank = _DOWNSTREAM.search(spaced), _BANK.search(spaced)
        if down:
            return f"{_short(text)} says {down[0]!r}: not the upstream sensor"
        if bank:
            return f"{_short(text)} says {bank[0]!r}: one of two banks, say which is bank 1"
        if _CATALYST.search(spaced) and not _UPSTREAM.search(spaced):
            return f"{_short(text)} names the catalyst: perhaps the downstream sensor"
    for text in texts[:2]:
        numbers = _sensor_numbers(text)
        words = words_of(text)
        if text is texts[0] and words[-1:] and words[-1].isdigit():
            numbers.append(int(words[-1]))
        other = [n for n in numbers if n not in (0, 1)]
        if other:
            return f"{text} has the number {other[0]}: perhaps bank 2 or the downstream sensor"
    return ""


def _sensor_numbers(text: str) -> list[int]:
    """Return the numbers of bank and sensor in a name: B1S2, O2S12, Lambda_2, Sonde 2."""
    numbers: list[int] = []
    words = words_of(text)
    for word, after in zip(words, (*words[1:], ""), strict=False):
        inside = _SENSOR_NUMBER.fullmatch(word)
        if inside:
            numbers += [int(digit) for digit in inside[1]]
        elif _NUMBERED.fullmatch(word) and after.isdigit():
            numbers += [int(digit) for digit in after.lstrip("0")] or [0]
    return numbers


def _spaced(text: str) -> str:
    return " ".join(words_of(text))


def _short(text: str) -> str:
    """Return a text on one line, of 60 characters at most."""
    line = " ".join(text.split())
    return line if len(line) <= 60 else line[:57] + "..."
