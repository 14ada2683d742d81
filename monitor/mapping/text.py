"""The proposed map as a TOML file, with the reason of every line, for a person to confirm."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from cantools.database.can import Database

from monitor.decode.log_blocks import keys_of
from monitor.decode.signal_map import LONGEST_TIMEOUT_S, Integrity
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks
from monitor.judge.causes.causes import timeout_of
from monitor.mapping.candidates import MapCandidate, cycle_ms, ranked
from monitor.mapping.proposal import NOTHING, Proposal, Proposals, propose
from monitor.mapping.recording import observe

_HEAD: Final = """\
Signal map for {dbc}, proposed by o2mon map from names, units and ranges{log}.
Confirm every line: the number is how sure the proposal is, 0 to 1, with its reason behind it.
What is commented out was not sure enough, or there was a choice; take one and remove the #.
value = factor * signal + offset, a value older than timeout_s is stale."""
_PLAIN: Final = {"factor": 1.0, "offset": 0.0}


def make_map(
    database: Database,
    dbc: Path,
    *,
    log: Path | None = None,
    channel: str = "",
    cylinders: int = 4,
    notes: Sequence[str] = (),
) -> tuple[str, Proposals]:
    """Return the text of the map that is proposed, and the proposals.

    log : CAN log of a drive that the proposals are checked with
    channel : of a log that holds several buses
    notes : what of the database could not be read as it stands
    Raises RecordingError if the log cannot be read.
    """
    candidates = ranked(database)
    observed = None
    if log:
        channels = Channels(channel, keys_of(database.messages))
        observed = observe(read_blocks(log, None, channels), candidates, dbc, database)
        candidates = observed.reranked(candidates)
    proposals = propose(candidates, cylinders)
    mapped = [p.best.message.name for p in (*proposals.signals, *proposals.auxiliary) if p.best]
    guards = observed.guards(mapped) if observed else {}
    return map_text(proposals, dbc, log, guards, notes), proposals


def map_text(
    proposals: Proposals,
    dbc: Path,
    log: Path | None = None,
    guards: Mapping[str, Integrity] = MappingProxyType({}),
    notes: Sequence[str] = (),
) -> str:
    """Return the file's text; ``monitor.decode.signal_map`` loads it if anything is proposed."""
    checked = f" and checked with {log.name}" if log else ""
    head = _HEAD.format(dbc=_line(dbc.name), log=_line(checked))
    lines = [*map(comment, head.splitlines()), ""]
    if notes:
        lines += [*map(comment, ("Changed or left out to read the database:", *notes)), ""]
    for name, own in guards.items():
        held = {"counter": own.counter, "checksum": own.checksum}
        held |= {"algorithm": own.algorithm} if own.checksum else {}
        lines += [comment("holds in the recording"), f"[messages.{toml(name)}]"]
        lines += [*(f"{key} = {toml(text)}" for key, text in held.items() if text), ""]
    lines += ["[signals]", *_entries(proposals.signals)]
    if proposals.auxiliary:
        lines += ["[auxiliary]", *_entries(proposals.auxiliary)]
    for each in proposals.derived:
        lines += [comment(f"made of {', '.join(each.sources)}"), f"[derived.{each.name}]"]
        lines += [f"factor = {toml(each.factor)}", f"numerator = {toml(each.numerator)}"]
        lines += [f"denominator = {toml(each.denominator)}", ""]
    return "\n".join(lines).rstrip() + "\n"


def toml(value: str | float | Sequence[str] | Mapping[str, Any]) -> str:
    """Return a value in TOML; what is its default in a map or a profile is left out of a table.

    >>> toml({"column": "AFR", "factor": 1.0, "pinned": [7.4, 22.3]})
    '{ column = "AFR", pinned = [7.4, 22.3] }'
    """
    if isinstance(value, (str, int)):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, float):
        return repr(float(f"{value:.10g}"))
    if isinstance(value, Mapping):
        told = {key: each for key, each in value.items() if each not in (_PLAIN.get(key), ())}
        return f"{{ {', '.join(f'{key} = {toml(each)}' for key, each in told.items())} }}"
    return f"[{', '.join(map(toml, value))}]"


def comment(text: str) -> str:
    """Return the text as one line that is a comment; TOML allows no control character in it.

    >>> comment("Motor\\x1fSpeed")
    '# Motor Speed'
    """
    return f"# {_line(text)}"


def _line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _entries(proposals: Sequence[Proposal]) -> Iterator[str]:
    lacking = [p.name for p in proposals if p.best is None and not p.others and p.note == NOTHING]
    if lacking:
        yield from (comment(f"{NOTHING}: {', '.join(lacking)}"), "")
    for each in (p for p in proposals if p.name not in lacking):
        word = "or" if each.best else "candidate"
        if each.best is None:
            yield comment(f"{each.name}: {each.note}")
        else:
            yield from (comment(_why(each.best)), _entry(each.name, each.best))
        for other in each.others:
            yield comment(f"  {word} {_why(other)}")
            yield comment(f"  {_entry(each.name, other)}")
        yield ""


def _why(candidate: MapCandidate) -> str:
    return f"{candidate.fit.confidence:.2f}: {'; '.join([candidate.place, *candidate.fit.why])}"


def _entry(name: str, candidate: MapCandidate) -> str:
    """Return the line of one signal."""
    entry = {
        "message": candidate.message.name,
        "signal": candidate.signal.name,
        "factor": candidate.fit.factor,
        "offset": candidate.fit.offset,
        "timeout_s": _timeout_s(candidate),
    }
    return f"{name} = {toml(entry)}"


def _timeout_s(candidate: MapCandidate) -> float:
    """Return how old a value may be: by the recording, else five cycles of the message.

    At least 0.3 s; 3 s for answers to requests, 0.5 s where the database states no cycle.
    """
    message = candidate.message
    if candidate.interval_s is not None:
        return timeout_of(candidate.interval_s)
    if message.cycle_time:
        return round(min(max(5 * cycle_ms(message) / 1000, 0.3), LONGEST_TIMEOUT_S), 3)
    return 3.0 if message.is_multiplexed() else 0.5
