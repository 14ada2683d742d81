"""The proposed map as a TOML file, with the reason of every line, for a person to confirm."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from cantools.database.can import Database

from monitor.decode.checksum import ALGORITHMS
from monitor.decode.log_blocks import keys_of
from monitor.decode.signal_map import LONGEST_TIMEOUT_S
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks
from monitor.judge.causes.causes import timeout_of
from monitor.mapping.candidates import MapCandidate, cycle_ms, ranked
from monitor.mapping.proposal import NOTHING, Proposal, Proposals, propose
from monitor.mapping.recording import Protection, observe, protections

_HEAD: Final = """\
Signal map for {dbc}, proposed by o2mon map from names, units and ranges{log}.
Confirm every line: the number is how sure the proposal is, 0 to 1, with its reason behind it.
What is commented out was not sure enough, or there was a choice; take one and remove the #.
value = factor * signal + offset, a value older than timeout_s is stale."""


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
    if observed:
        candidates = observed.reranked(candidates)
    proposals = propose(candidates, cylinders)
    mapped = [p.best for p in (*proposals.signals, *proposals.auxiliary) if p.best]
    guarded = protections(c.message for c in mapped)
    if observed:
        guarded = observed.protections(guarded)
    return map_text(proposals, dbc, log, guarded, notes), proposals


def map_text(
    proposals: Proposals,
    dbc: Path,
    log: Path | None = None,
    guarded: Sequence[Protection] = (),
    notes: Sequence[str] = (),
) -> str:
    """Return the file's text; ``monitor.decode.signal_map`` loads it if anything is proposed."""
    checked = f" and checked with {log.name}" if log else ""
    head = _HEAD.format(dbc=_line(dbc.name), log=_line(checked))
    lines = [*map(comment, head.splitlines()), ""]
    if notes:
        lines += [*map(comment, ("Changed or left out to read the database:", *notes)), ""]
    lines += [line for each in guarded for line in _guard(each)]
    lines += ["[signals]", *_entries(proposals.signals)]
    if proposals.auxiliary:
        lines += ["[auxiliary]", *_entries(proposals.auxiliary)]
    for each in proposals.derived:
        lines += [
            comment(each.why),
            f"[derived.{each.name}]",
            f"factor = {each.factor!r}",
            f"numerator = {json.dumps(list(each.numerator))}",
            f"denominator = {json.dumps(list(each.denominator))}",
            "",
        ]
    return "\n".join(lines).rstrip() + "\n"


def quoted(text: str) -> str:
    """Return the text as a TOML string.

    >>> quoted('a"b')
    '"a\\\\"b"'
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def comment(text: str) -> str:
    """Return the text as one line that is a comment; TOML allows no control character in it.

    >>> comment("Motor\\x1fSpeed")
    '# Motor Speed'
    """
    return f"# {_line(text)}"


def _line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)


def _guard(each: Protection) -> Iterator[str]:
    """Yield the table of one message, commented out where no recording bears it out."""
    keys = [f"counter = {quoted(each.counter)}"] if each.counter else []
    if each.checksum:
        algorithm = each.algorithm or ALGORITHMS[0]
        keys += [f"checksum = {quoted(each.checksum)}", f'algorithm = "{algorithm}"']
    table = [f"[messages.{quoted(each.message.name)}]", *keys]
    if not each.n_frames:
        yield comment("by its names; check with a recording (--log), then remove the #")
        yield from (*map(comment, table), "")
    elif keys:
        yield comment(f"holds in {each.n_frames} frames of the recording")
        yield from (*table, "")


def _entries(proposals: Sequence[Proposal]) -> Iterator[str]:
    lacking = [p.name for p in proposals if p.best is None and not p.others and p.note == NOTHING]
    if lacking:
        yield from (comment(f"{NOTHING}: {', '.join(lacking)}"), "")
    for each in proposals:
        if each.name in lacking:
            continue
        word = "candidate"
        if each.best is None:
            yield comment(f"{each.name}: {each.note}")
        else:
            word = "or"
            yield comment(_why(each.best))
            yield _entry(each.name, each.best)
        for other in each.others:
            yield comment(f"  {word} {_why(other)}")
            yield comment(f"  {_entry(each.name, other)}")
        yield ""


def _why(candidate: MapCandidate) -> str:
    why = "; ".join([candidate.place, *candidate.why])
    return f"{candidate.confidence:.2f}: {why}"


def _entry(name: str, candidate: MapCandidate) -> str:
    """Return the line of one signal."""
    message = candidate.message
    parts = [f"message = {quoted(message.name)}", f"signal = {quoted(candidate.signal.name)}"]
    if candidate.factor != 1.0:
        parts.append(f"factor = {_number(candidate.factor)}")
    if candidate.offset != 0.0:
        parts.append(f"offset = {_number(candidate.offset)}")
    parts.append(f"timeout_s = {_timeout_s(candidate)!r}")
    return f"{name} = {{ {', '.join(parts)} }}"


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


def _number(value: float) -> str:
    """Return a number as short as it can be read back, to ten digits."""
    return repr(float(f"{value:.10g}"))
