"""The proposed map as a TOML file, with every line's reason, for a person to confirm."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from cantools.database.can import Message

from monitor.mapping.candidate import Candidate
from monitor.mapping.propose import NOTHING, Proposal, Proposals
from monitor.mapping.protection import Protection
from monitor.mapping.toml_text import plain, quoted

_HEAD: Final = """\
# Signal map for {dbc}, proposed by o2mon map from names, units and ranges{log}.
# Confirm every line: the number is how sure the proposal is, 0 to 1, with its reason behind it.
# What is commented out was not sure enough, or there was a choice; take one and remove the #.
# value = factor * signal + offset, a value older than timeout_s is stale.
"""


def map_text(
    proposals: Proposals, dbc: Path, log: Path | None = None, protection: Protection | None = None
) -> str:
    """Return the file's text; ``monitor.decode.signal_map`` loads it if anything is proposed."""
    checked = f" and checked with {plain(log.name)}" if log else ""
    lines = [_HEAD.format(dbc=plain(dbc.name), log=checked)]
    lines += protection.lines() if protection else []
    lines += ["[signals]", *_entries(proposals.signals)]
    if proposals.auxiliary:
        lines += ["[auxiliary]", *_entries(proposals.auxiliary)]
    for each in proposals.derived:
        lines += [
            f"# {each.why}",
            f"[derived.{each.name}]",
            f"factor = {each.factor!r}",
            f"numerator = {json.dumps(list(each.numerator))}",
            f"denominator = {json.dumps(list(each.denominator))}",
            "",
        ]
    return "\n".join(lines).rstrip() + "\n"


def _entries(proposals: Sequence[Proposal]) -> Iterator[str]:
    lacking = [p.name for p in proposals if p.best is None and not p.others and p.note == NOTHING]
    if lacking:
        yield f"# {NOTHING}: {', '.join(lacking)}"
        yield ""
    for each in proposals:
        if each.name in lacking:
            continue
        if each.best is not None:
            yield f"# {each.best.confidence:.2f}: {_why(each.best)}"
            yield entry(each.name, each.best)
            yield from _others("or", each)
        else:
            yield f"# {each.name}: {each.note}"
            yield from _others("candidate", each)
        yield ""


def _others(word: str, proposal: Proposal) -> Iterator[str]:
    for other in proposal.others:
        yield f"#   {word} {other.confidence:.2f}: {_why(other)}"
        yield f"#   {entry(proposal.name, other)}"


def entry(name: str, candidate: Candidate) -> str:
    """Return the line of one signal."""
    parts = [
        f"message = {quoted(candidate.message.name)}",
        f"signal = {quoted(candidate.signal.name)}",
    ]
    if candidate.factor != 1.0:
        parts.append(f"factor = {_number(candidate.factor)}")
    if candidate.offset != 0.0:
        parts.append(f"offset = {_number(candidate.offset)}")
    parts.append(f"timeout_s = {timeout_s(candidate.message)!r}")
    return f"{name} = {{ {', '.join(parts)} }}"


def timeout_s(message: Message) -> float:
    """Return how old a value of the message may be: five cycles, at least 0.3 s.

    3 s for answers to requests, 0.5 s where the cycle is not known.
    """
    if message.is_multiplexed() and not message.cycle_time:
        return 3.0
    if not message.cycle_time:
        return 0.5
    return round(max(5 * message.cycle_time / 1000, 0.3), 3)


def _why(candidate: Candidate) -> str:
    reasons = [candidate.blocked] if candidate.blocked else []
    return plain(f"{candidate.place}; {'; '.join([*reasons, *candidate.why])}")


def _number(value: float) -> str:
    """Return a number as short as it can be read back, to ten digits."""
    return repr(float(f"{value:.10g}"))
