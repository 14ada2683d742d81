"""The signal map that is proposed for a database, with the reason of every line."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Final

from cantools.database.can import Database

from monitor.base.signals import OWN
from monitor.decode.log_blocks import keys_of
from monitor.decode.signal_map import Derived
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks
from monitor.mapping.candidates import candidates
from monitor.mapping.proposal import Proposal, SignalCandidate, comment, entries, propose, toml
from monitor.mapping.recording import ShownSignals
from monitor.mapping.vocabulary import FUEL_FLOW_NAME

CONSIDERED: Final = 8  # candidates of each signal that are compared with the recording
PHI_NAMES: Final = {"lambda_measured": "phi_measured", "lambda_target": "phi_target"}
FLOWS: Final = {"fuel_mass_mg": FUEL_FLOW_NAME, "air_mass_mg": "maf_kg_h"}
STROKES_MG_PER_KG_H: Final = 1e6 / 30.0  # kg/h to mg per stroke: this / cylinders / speed
_HEAD: Final = files("monitor.mapping").joinpath("map.template").read_text("utf-8")


@dataclass(frozen=True, slots=True)
class MapProposal:
    """A whole map to confirm."""

    signals: tuple[Proposal, ...]  # one per canonical signal, in their order
    auxiliary: tuple[Proposal, ...]
    derived: tuple[Derived, ...]

    @property
    def found(self) -> tuple[SignalCandidate, ...]:
        """Return the signals that are mapped to a canonical one directly."""
        return tuple(p.best for p in self.signals if p.best is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the canonical signals that the map provides."""
        got = {c.name for c in self.found} | {d.name for d in self.derived}
        return tuple(s.name for s in OWN if s.name in got)


def make_map(
    database: Database,
    dbc: Path,
    *,
    log: Path | None = None,
    channel: str = "",
    cylinders: int = 4,
    notes: Sequence[str] = (),
) -> tuple[str, MapProposal]:
    """Return the text of the map that is proposed, and the proposals.

    ``monitor.decode.signal_map`` loads it if anything is proposed.

    log : CAN log of a drive that the proposals are checked with
    channel : of a log that holds several buses
    cylinders : fuel and air per stroke follow from flows with their number
    notes : what of the database could not be read as it stands
    Raises RecordingError if the log cannot be read.
    """
    proposals, guards = propose(candidates(database)), dict[str, dict[str, str]]()
    if log:
        blocks = read_blocks(log, None, Channels(channel, keys_of(database.messages)))
        likeliest = {each.place for p in proposals.values() for each in p.ranked[:CONSIDERED]}
        recording = ShownSignals(blocks, likeliest, dbc, database)
        proposals = propose(candidates(database, recording.observed))
        guards = recording.guards({p.best.place for p in proposals.values() if p.best})
    proposal = _made(proposals, cylinders)
    head = _HEAD.format(dbc=dbc.name, log=f" and checked with {log.name}" if log else "")
    changed = ["Changed or left out to read the database:", *notes] if notes else []
    sections = {
        "messages": [f"{toml(name)} = {toml(held)}" for name, held in guards.items()],
        "signals": entries(proposal.signals),
        "auxiliary": entries(proposal.auxiliary),
        "derived": [
            f"{each.name} = {toml({**asdict(each), 'name': ''})}" for each in proposal.derived
        ],
    }
    lines = [*map(comment, [*head.splitlines(), *changed])]
    for title, rows in sections.items():
        lines += ["", f"[{title}]", *rows] if rows else []
    return "\n".join(lines) + "\n", proposal


def _made(proposals: dict[str, Proposal], cylinders: int) -> MapProposal:
    """Return the proposals with what is made of others, where nothing carries it itself."""
    auxiliary: list[Proposal] = []
    derived: list[Derived] = []
    for name, phi in PHI_NAMES.items():
        best = proposals[name].best
        if best and best.fit.is_phi:
            auxiliary.append(Proposal(phi, (best,)))
            derived.append(Derived(name, 1.0, (), (phi,)))
    for name, flow in FLOWS.items() if proposals["engine_speed_rpm"].best else ():
        if proposals[flow].best and not proposals[name].best:
            auxiliary += [proposals[flow]] if flow == FUEL_FLOW_NAME else []
            factor = STROKES_MG_PER_KG_H / cylinders
            derived.append(Derived(name, factor, (flow,), ("engine_speed_rpm",)))
    for each in derived:
        proposals[each.name] = replace(proposals[each.name], note="derived below")
    return MapProposal(tuple(proposals[s.name] for s in OWN), tuple(auxiliary), tuple(derived))
