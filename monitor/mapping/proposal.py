"""One proposal per canonical signal: the signal to take, the alternatives, and the reasons."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from monitor.base.signals import OWN
from monitor.mapping.candidates import MapCandidate
from monitor.mapping.quantities import FUEL_FLOW_NAME, OF_ONE_SENSOR

SURE: Final = 0.6  # a candidate of this confidence is proposed
RIVAL: Final = 0.4  # another sensor's signal of this confidence is a choice for a person
SHOWN: Final = 4  # candidates in the file
NOTHING: Final = "nothing in the database looks like it"
PHI_NAMES: Final = {"lambda_measured": "phi_measured", "lambda_target": "phi_target"}
STROKES_MG_PER_KG_H: Final = 1e6 / 30.0  # kg/h to mg per stroke: this / cylinders / speed


@dataclass(frozen=True, slots=True)
class Proposal:
    """The proposal for one canonical signal."""

    name: str
    best: MapCandidate | None  # None where a person must choose
    others: tuple[MapCandidate, ...] = ()  # the likeliest first
    note: str = ""  # the reason why nothing is proposed


@dataclass(frozen=True, slots=True)
class DerivedEntry:
    """A signal that follows from proposed ones."""

    name: str
    factor: float
    numerator: tuple[str, ...]
    denominator: tuple[str, ...]
    why: str


@dataclass(frozen=True, slots=True)
class Proposals:
    """A whole map to confirm."""

    signals: tuple[Proposal, ...]  # one per canonical signal, in their order
    auxiliary: tuple[Proposal, ...]
    derived: tuple[DerivedEntry, ...]

    @property
    def found(self) -> tuple[MapCandidate, ...]:
        """Return the signals that are mapped to a canonical one directly."""
        return tuple(p.best for p in self.signals if p.best is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the canonical signals that the map provides."""
        got = {c.name for c in self.found} | {d.name for d in self.derived}
        return tuple(s.name for s in OWN if s.name in got)


def propose(ranked: Mapping[str, Sequence[MapCandidate]], cylinders: int = 4) -> Proposals:
    """Return the proposals.

    ranked : candidates by canonical name, the likeliest first
    cylinders : fuel and air per stroke follow from flows with their number
    """
    taken = _assigned(ranked)
    auxiliary: list[Proposal] = []
    derived: list[DerivedEntry] = []
    for name, phi in PHI_NAMES.items():
        if name in taken and taken[name].is_phi:
            auxiliary.append(Proposal(phi, taken[name]))
            derived.append(DerivedEntry(name, 1.0, (), (phi,), "lambda is 1 / phi"))
    flows = {"air_mass_mg": "maf_kg_h"} if "maf_kg_h" in taken else {}
    flow = ranked.get(FUEL_FLOW_NAME, ())
    if "fuel_mass_mg" not in taken and not _doubt(flow) and "engine_speed_rpm" in taken:
        auxiliary.append(Proposal(FUEL_FLOW_NAME, flow[0], tuple(flow[1:])))
        flows = {"fuel_mass_mg": FUEL_FLOW_NAME, **flows}
    for name, source in flows.items():
        if name not in taken and "engine_speed_rpm" in taken:
            why = f"kg/h and speed to mg per stroke of one of {cylinders} cylinders"
            factor = STROKES_MG_PER_KG_H / cylinders
            derived.append(DerivedEntry(name, factor, (source,), ("engine_speed_rpm",), why))
    below = {each.name for each in derived}
    signals = (_proposal(s.name, ranked.get(s.name, ()), taken, below) for s in OWN)
    return Proposals(tuple(signals), tuple(auxiliary), tuple(derived))


def _assigned(ranked: Mapping[str, Sequence[MapCandidate]]) -> dict[str, MapCandidate]:
    """Return the best candidate by canonical name, the surest first, no place twice."""
    taken: dict[str, MapCandidate] = {}
    places: set[tuple[str, str]] = set()
    bests = [each[0] for each in ranked.values() if not _doubt(each)]
    for best in sorted(bests, key=lambda c: (-c.confidence, c.name)):
        place = (best.message.name, best.signal.name)
        if best.name != FUEL_FLOW_NAME and place not in places:
            places.add(place)
            taken[best.name] = best
    return taken


def _doubt(candidates: Sequence[MapCandidate]) -> str:
    """Return why none of the candidates is proposed, "" if the first is."""
    if not candidates:
        return NOTHING
    best, *others = candidates
    if best.doubts:
        return "; ".join(best.doubts)
    if best.confidence < SURE:
        return "not sure enough"
    rivals = [c for c in others if c.is_named and c.confidence >= RIVAL]
    tell_apart = best.is_stated and not any(c.is_stated for c in rivals)
    if best.name in OF_ONE_SENSOR and rivals and not tell_apart:
        return "AMBIGUOUS: several sensors, say which is the upstream one of bank 1"
    return ""


def _proposal(
    name: str,
    candidates: Sequence[MapCandidate],
    taken: Mapping[str, MapCandidate],
    derived: set[str],
) -> Proposal:
    best = taken.get(name)
    if best is None:
        others = tuple(candidates[:SHOWN])
        note = _doubt(candidates) or f"{candidates[0].place} is taken for another signal"
    else:
        others, note = tuple(c for c in candidates if c is not best)[: SHOWN - 1], ""
    if name in derived:
        return Proposal(name, None, others, "derived below")
    return Proposal(name, best, others, note)
