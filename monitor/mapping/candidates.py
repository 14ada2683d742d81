"""Which signals of a database could be a canonical one, how sure that is, and why."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from cantools.database.can import Database, Message, Signal

from monitor.mapping.candidate import Candidate
from monitor.mapping.meanings import MEANINGS, OF_ONE_SENSOR, OTHER, Meaning
from monitor.mapping.scaling import in_range, scaled
from monitor.mapping.sensor import elsewhere, is_upstream, short
from monitor.mapping.words import match, words_of


def candidates(database: Database, name: str, meaning: Meaning | None = None) -> list[Candidate]:
    """Return what may be the canonical signal ``name``, the likeliest first."""
    meaning = meaning or MEANINGS[name]
    found = [
        candidate
        for message, signal in _signals(database)
        if (candidate := judge(name, meaning, message, signal)) is not None
    ]
    return sorted(found, key=lambda c: (bool(c.blocked), -c.confidence, *preference(c)))


def preference(candidate: Candidate) -> tuple[float, float, str]:
    """Return what decides between equals: the faster message, the finer steps, then the name."""
    cycle_ms = candidate.message.cycle_time or 1e6
    return float(cycle_ms), abs(float(candidate.signal.scale) * candidate.factor), candidate.place


def _signals(database: Database) -> Iterator[tuple[Message, Signal]]:
    """Yield what a map can name: a message or signal whose name is another's, too, is left out."""
    last = {message.name: message for message in database.messages}
    for message in last.values():
        names = Counter(signal.name for signal in message.signals)
        for signal in message.signals:
            if not signal.is_multiplexer and signal.length <= 64 and names[signal.name] == 1:
                yield message, signal


def judge(name: str, meaning: Meaning, message: Message, signal: Signal) -> Candidate | None:
    """Return the signal as a candidate, None if it cannot be."""
    sure, why = _name(meaning, message, signal)
    if sure <= 0.0:
        return None
    made = scaled(Candidate(name, message, signal, 1.0, 1.0, 0.0, ()), meaning)
    if made is None:
        return None
    named = replace(made, confidence=sure * made.confidence, why=(why, *made.why))
    fitting = in_range(named, meaning)
    return None if fitting is None else _numbered(fitting)


def _name(meaning: Meaning, message: Message, signal: Signal) -> tuple[float, str]:
    """Return how sure the names make it, and which one."""
    own = words_of(signal.name)
    if _is_other(meaning, own):
        return 0.0, ""
    sure, why = match(meaning.phrases, own), f"its name says {signal.name}"
    both = 0.85 * match(meaning.phrases, own + words_of(message.name))
    if both > sure and not _is_other(meaning, words_of(message.name)):
        sure, why = both, f"its name and its message say {message.name} {signal.name}"
    if signal.comment:
        comment = words_of(signal.comment)
        told = 0.8 * match(meaning.phrases, comment)
        if told > sure and not _is_other(meaning, comment):
            sure, why = told, f"its comment says {short(signal.comment)}"
    return sure, why


def _is_other(meaning: Meaning, words: tuple[str, ...]) -> bool:
    if meaning.never.intersection(words):
        return True
    if any(len(stem) > 4 and stem in word for stem in meaning.never for word in words):
        return True
    name = "_".join(words) + "_"
    return (
        not meaning.is_flag
        and any(stem in words if len(stem) < 5 else stem in name for stem in OTHER)
        and not _is_wanted(meaning, words)
    )


def _is_wanted(meaning: Meaning, words: tuple[str, ...]) -> bool:
    """Return whether what elsewhere means another thing is just what is meant here."""
    return meaning is MEANINGS["lambda_target"] and not {"max", "min", "limit"}.intersection(words)


def _numbered(candidate: Candidate) -> Candidate:
    """Return the candidate, blocked if it belongs to another sensor, less sure if a second."""
    texts = (candidate.signal.name, candidate.message.name, candidate.signal.comment or "")
    numbers = [w for w in words_of(texts[0]) if w.isdigit() and int(w) > 1]
    if candidate.name not in OF_ONE_SENSOR:
        if not numbers:
            return candidate
        said = f"its name ends in {numbers[0]}: perhaps a second one"
        return replace(
            candidate, confidence=candidate.confidence * 0.75, why=(*candidate.why, said)
        )
    reason = elsewhere(texts)
    if reason:
        return replace(candidate, blocked=reason)
    stated, sure, why = False, candidate.confidence, candidate.why
    if any(is_upstream(text) for text in texts):
        stated, sure = True, min(1.0, sure + 0.1)
        why = (*why, "it is said to be upstream")
    elif candidate.name == "lambda_measured":
        why = (*why, "nothing says whether it is upstream: check")
    return replace(candidate, confidence=sure, why=why, is_stated=stated)
