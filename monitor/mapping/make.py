"""From a database, and perhaps a recording, to the text of a map."""

from pathlib import Path

from cantools.database.can import Database

from monitor.frames.logs import read_frames
from monitor.mapping.observe import observe, reranked
from monitor.mapping.propose import Proposals, propose, ranked
from monitor.mapping.protection import borne_out, protection
from monitor.mapping.text import map_text


def make_map(
    database: Database, dbc: Path, *, log: Path | None = None, cylinders: int = 4
) -> tuple[str, Proposals]:
    """Return the text of the map that is proposed, and the proposals.

    log : CAN log of a drive that the proposals are checked with
    Raises RecordingError if the log cannot be read.
    """
    found = ranked(database)
    observed = observe(read_frames(log), found, dbc) if log else None
    if observed:
        found = reranked(found, observed)
    proposals = propose(database, cylinders, found)
    mapped = [p.best for p in (*proposals.signals, *proposals.auxiliary) if p.best]
    guarded = protection(c.message for c in mapped)
    if observed:
        guarded = borne_out(guarded, observed.payloads)
    return map_text(proposals, dbc, log, guarded), proposals
