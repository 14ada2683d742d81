"""For each canonical signal the candidate to take, the alternatives, and the reasons.

A candidate is a signal of a database or a column of a table. What is proposed stands as a line of a
TOML file, for a person to confirm; all else is a comment.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final

from monitor.mapping.fit import QuantityFit
from monitor.mapping.vocabulary import QUANTITIES

RIVAL: Final = 0.4  # another sensor's signal of this confidence is a choice for a person
SHOWN: Final = 4  # candidates in the file
NOTHING: Final = "nothing looks like it"
_PLAIN: Final = {"factor": 1.0, "offset": 0.0}

Entry = str | float | Sequence[Any] | Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SignalCandidate:
    """A signal or a column that may be the canonical signal."""

    name: str  # canonical
    place: str  # message and signal, or column
    fit: QuantityFit
    entry: Entry  # in the file
    order: tuple[Any, ...]  # among those that are as likely
    is_known: bool = False  # by its name: there is no choice

    @property
    def rank(self) -> tuple[Any, ...]:
        """Return the order: no doubt, likely, then its own order."""
        return bool(self.fit.doubt), -self.fit.confidence, not self.is_known, self.order


@dataclass(frozen=True, slots=True)
class Proposal:
    """The proposal for one canonical signal, or for one that others are made of."""

    name: str
    ranked: Sequence[SignalCandidate]  # the likeliest first
    note: str = ""  # the reason why the first is not proposed

    @property
    def best(self) -> SignalCandidate | None:
        """Return the candidate to take, None where a person must choose."""
        return None if self.note else self.ranked[0]


def propose(candidates: Mapping[str, Iterable[SignalCandidate]]) -> dict[str, Proposal]:
    """Return a proposal for each name; no place is taken twice."""
    rank, ranked = attrgetter("rank"), dict[str, list[SignalCandidate]]()
    for name, each in candidates.items():
        likeliest = {c.place: c for c in sorted(each, key=rank, reverse=True)}  # of each place
        ranked[name] = sorted(likeliest.values(), key=rank)
    notes = {name: _note(name, ranked[name]) for name in ranked}
    bests = [ranked[name][0] for name in ranked if not notes[name]]
    taken: dict[str, str] = {}  # by place
    for best in sorted(bests, key=lambda c: (-c.fit.confidence, not c.is_known, c.name)):
        if taken.setdefault(best.place, best.name) != best.name:
            notes[best.name] = f"{best.place} is taken for another signal"
    return {name: Proposal(name, ranked[name], notes[name]) for name in ranked}


def _note(name: str, ranked: Sequence[SignalCandidate]) -> str:
    """Return why none of the candidates is proposed, "" if the first is."""
    if not ranked:
        return NOTHING
    best, *others = ranked
    if best.fit.doubt or best.is_known:
        return best.fit.doubt
    if others and others[0].rank == best.rank:
        return "several say it equally well"
    rivals = [each.fit for each in others if each.fit.confidence >= RIVAL]
    tell_apart = best.fit.is_upstream and not any(rival.is_upstream for rival in rivals)
    if QUANTITIES[name].one_sensor and rivals and not tell_apart:
        return "AMBIGUOUS: several sensors, say which is the upstream one of bank 1"
    return ""


def entries(proposals: Sequence[Proposal]) -> list[str]:
    """Return the lines of the proposals, each with its reason."""
    lacking = [each.name for each in proposals if each.note == NOTHING]
    lines = [comment(f"{NOTHING}: {', '.join(lacking)}")] if lacking else []
    for each in (p for p in proposals if p.name not in lacking):
        lines += ["", *([comment(f"{each.name}: {each.note}")] if each.note else [])]
        for candidate in each.ranked[:SHOWN]:
            reasons = "; ".join([candidate.place, *candidate.fit.why])
            why = f"{candidate.fit.confidence:.2f}: {reasons}"
            entry = f"{each.name} = {toml(candidate.entry)}"
            if candidate is not each.best:
                why = f"  {'or' if each.best else 'candidate'} {why}"
                entry = comment(f"  {entry}")
            lines += [comment(why), entry]
    return lines


def toml(value: Entry) -> str:
    """Return a value in TOML; what is its default in a map or a profile is left out of a table.

    >>> toml({"column": "AFR", "factor": 1.0, "pinned": [7.4, 22.3]})
    '{ column = "AFR", pinned = [7.4, 22.3] }'
    """
    if isinstance(value, (str, int)):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, float):
        return repr(float(f"{value:.10g}"))
    if isinstance(value, Mapping):
        told = {key: each for key, each in value.items() if each not in (_PLAIN.get(key), (), "")}
        return f"{{ {', '.join(f'{key} = {toml(each)}' for key, each in told.items())} }}"
    return f"[{', '.join(map(toml, value))}]"


def comment(text: str) -> str:
    """Return the text as one line that is a comment; TOML allows no control character in it.

    >>> comment("Motor\\x1fSpeed")
    '# Motor Speed'
    """
    return "# " + "".join(c if c.isprintable() else " " for c in text)
