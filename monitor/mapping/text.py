"""The proposed map as a TOML file, with the reason of every line, for a person to confirm."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from cantools.database.can import Database

from monitor.decode.log_blocks import keys_of
from monitor.decode.signal_map import LONGEST_TIMEOUT_S, Integrity
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks
from monitor.judge.causes.causes import timeout_of
from monitor.mapping.candidates import MapCandidate, cycle_ms, ranked
from monitor.mapping.proposal import NOTHING, Proposal, Proposals, propose
from monitor.mapping.recording import ObservedSignals

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

    ``monitor.decode.signal_map`` loads it if anything is proposed.

    log : CAN log of a drive that the proposals are checked with
    channel : of a log that holds several buses
    notes : what of the database could not be read as it stands
    Raises RecordingError if the log cannot be read.
    """
    candidates, guards = ranked(database), dict[str, Integrity]()
    if not log:
        proposals = propose(candidates, cylinders)
    else:
        blocks = read_blocks(log, None, Channels(channel, keys_of(database.messages)))
        observed = ObservedSignals(blocks, candidates, dbc, database)
        proposals = propose(observed.reranked(), cylinders)
        every = (*proposals.signals, *proposals.auxiliary)
        guards = observed.guards(each.best.message.name for each in every if each.best)
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
    return "\n".join(lines).rstrip() + "\n", proposals


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
    lacking = [p.name for p in proposals if not (p.best or p.others) and p.note == NOTHING]
    if lacking:
        yield from (comment(f"{NOTHING}: {', '.join(lacking)}"), "")
    for each in (p for p in proposals if p.name not in lacking):
        if each.best:
            why, entry = _entry(each.name, each.best)
            yield from (comment(why), entry)
        else:
            yield comment(f"{each.name}: {each.note}")
        for other in each.others:
            why, entry = _entry(each.name, other)
            yield comment(f"  {'or' if each.best else 'candidate'} {why}")
            yield comment(f"  {entry}")
        yield ""


def _entry(name: str, candidate: MapCandidate) -> tuple[str, str]:
    """Return the reason for a signal, and its line."""
    fit, message = candidate.fit, candidate.message
    if candidate.interval_s is not None:
        timeout_s = timeout_of(candidate.interval_s)
    elif message.cycle_time:  # five cycles
        timeout_s = round(min(max(5 * cycle_ms(message) / 1000, 0.3), LONGEST_TIMEOUT_S), 3)
    else:  # answers to requests come slowly
        timeout_s = 3.0 if message.is_multiplexed() else 0.5
    entry = {
        "message": message.name,
        "signal": candidate.signal.name,
        "factor": fit.factor,
        "offset": fit.offset,
        "timeout_s": timeout_s,
    }
    why = "; ".join([candidate.place, *fit.why])
    return f"{fit.confidence:.2f}: {why}", f"{name} = {toml(entry)}"
