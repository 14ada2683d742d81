"""One proposal per canonical signal: the signal to take, the alternatives, and the reasons."""

from dataclasses import dataclass
from typing import Final

from monitor.base.signals import OWN
from monitor.decode.signal_map import Derived
from monitor.mapping.candidates import MapCandidate, Ranked
from monitor.mapping.quantities import FUEL_FLOW_NAME, QUANTITIES

RIVAL: Final = 0.4  # another sensor's signal of this confidence is a choice for a person
SHOWN: Final = 4  # candidates in the file
NOTHING: Final = "nothing in the database looks like it"
PHI_NAMES: Final = {"lambda_measured": "phi_measured", "lambda_target": "phi_target"}
FLOWS: Final = {"fuel_mass_mg": FUEL_FLOW_NAME, "air_mass_mg": "maf_kg_h"}
STROKES_MG_PER_KG_H: Final = 1e6 / 30.0  # kg/h to mg per stroke: this / cylinders / speed


@dataclass(frozen=True, slots=True)
class Proposal:
    """The proposal for one canonical signal, or for one that others are made of."""

    name: str
    best: MapCandidate | None  # None where a person must choose
    others: tuple[MapCandidate, ...] = ()  # the likeliest first
    note: str = ""  # the reason why nothing is proposed


@dataclass(frozen=True, slots=True)
class Proposals:
    """A whole map to confirm."""

    signals: tuple[Proposal, ...]  # one per canonical signal, in their order
    auxiliary: tuple[Proposal, ...]
    derived: tuple[Derived, ...]

    @property
    def found(self) -> tuple[MapCandidate, ...]:
        """Return the signals that are mapped to a canonical one directly."""
        return tuple(p.best for p in self.signals if p.best is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the canonical signals that the map provides."""
        got = {c.name for c in self.found} | {d.name for d in self.derived}
        return tuple(s.name for s in OWN if s.name in got)


def propose(ranked: Ranked, cylinders: int = 4) -> Proposals:
    """Return the proposals.

    cylinders : fuel and air per stroke follow from flows with their number
    """
    doubts = {name: _doubt(name, ranked) for name in ranked}
    taken: dict[str, MapCandidate] = {}
    bests = [ranked[name][0] for name in ranked if not doubts[name]]
    for each in sorted(bests, key=lambda c: (-c.fit.confidence, c.name)):
        if each.place not in {c.place for c in taken.values()}:
            taken[each.name] = each
    auxiliary: list[Proposal] = []
    derived: list[Derived] = []
    for name, phi in PHI_NAMES.items():
        if name in taken and taken[name].fit.is_phi:
            auxiliary.append(Proposal(phi, taken.pop(name)))
            derived.append(Derived(name, 1.0, (), (phi,)))
    for name, flow in FLOWS.items() if "engine_speed_rpm" in taken else ():
        if flow in taken and name not in taken:
            auxiliary += [Proposal(flow, taken[flow])] if flow == FUEL_FLOW_NAME else []
            factor = STROKES_MG_PER_KG_H / cylinders
            derived.append(Derived(name, factor, (flow,), ("engine_speed_rpm",)))
    notes = doubts | {made.name: "derived below" for made in derived}
    signals = []
    for name in (signal.name for signal in OWN):
        best, every = taken.get(name), ranked[name]
        others = tuple(c for c in every if c is not best)[: SHOWN - (best is not None)]
        note = "" if best else notes[name] or f"{every[0].place} is taken for another signal"
        signals.append(Proposal(name, best, others, note))
    return Proposals(tuple(signals), tuple(auxiliary), tuple(derived))


def _doubt(name: str, ranked: Ranked) -> str:
    """Return why none of the candidates is proposed, "" if the first is."""
    if not ranked[name]:
        return NOTHING
    best, *others = ranked[name]
    if not best.fit.stands:
        return "; ".join(best.fit.doubts) or "not sure enough"
    rivals = [c.fit for c in others if c.fit.confidence >= RIVAL]
    tell_apart = best.fit.is_upstream and not any(rival.is_upstream for rival in rivals)
    if QUANTITIES[name].one_sensor and rivals and not tell_apart:
        return "AMBIGUOUS: several sensors, say which is the upstream one of bank 1"
    return ""
