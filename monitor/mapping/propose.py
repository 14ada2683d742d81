"""One proposal per canonical signal: what is taken, what else could be, and why."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from cantools.database.can import Database

from monitor.base.signals import SIGNALS
from monitor.mapping.candidate import Candidate
from monitor.mapping.candidates import candidates
from monitor.mapping.meanings import FUEL_FLOW, MEANINGS, OF_ONE_SENSOR

SURE: Final = 0.6  # from here on a candidate is proposed
RIVAL: Final = 0.4  # from here on another sensor's signal is a choice for a person
MARGIN: Final = 0.05  # candidates closer than this are not told apart
SHOWN: Final = 4  # candidates in the file
NOTHING: Final = "nothing in the database looks like it"
FUEL_FLOW_NAME: Final = "fuel_flow_kg_h"
PHI_NAME: Final = "phi_measured"
STROKES_MG_PER_KG_H: Final = 1e6 / 30.0  # kg/h to mg per stroke: this / cylinders / speed


@dataclass(frozen=True, slots=True)
class Proposal:
    """What is proposed for one canonical signal."""

    name: str
    best: Candidate | None  # None where a person must choose
    others: tuple[Candidate, ...]  # the likeliest first
    note: str = ""  # why nothing is proposed


@dataclass(frozen=True, slots=True)
class Derived:
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
    auxiliary: tuple[Proposal, ...] = ()
    derived: tuple[Derived, ...] = ()
    database: Database | None = field(default=None, repr=False)

    @property
    def found(self) -> tuple[Candidate, ...]:
        """Return what is mapped to a canonical signal directly."""
        return tuple(p.best for p in self.signals if p.best is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the canonical signals that the map provides."""
        got = {c.name for c in self.found} | {d.name for d in self.derived}
        return tuple(s.name for s in SIGNALS if s.name in got)


Ranked = Mapping[str, Iterable[Candidate]]


def ranked(database: Database) -> dict[str, list[Candidate]]:
    """Return the candidates of every canonical signal and of the fuel flow."""
    found = {name: candidates(database, name) for name in MEANINGS}
    return found | {FUEL_FLOW_NAME: candidates(database, FUEL_FLOW_NAME, FUEL_FLOW)}


def propose(database: Database, cylinders: int = 4, among: Ranked | None = None) -> Proposals:
    """Return the proposals for a database.

    cylinders : fuel and air per stroke follow from flows with it
    among : candidates instead of those the names give, from a recording for instance
    """
    found = {name: list(each) for name, each in (among or ranked(database)).items()}
    taken: dict[str, Candidate] = {}
    _assign(found, taken)
    signals = [_proposal(s.name, found.get(s.name, []), taken) for s in SIGNALS]
    auxiliary: list[Proposal] = []
    derived: list[Derived] = []
    phi = taken.get("lambda_measured")
    if phi is not None and phi.is_phi:
        auxiliary.append(Proposal(PHI_NAME, phi, ()))
        derived.append(Derived("lambda_measured", 1.0, (), (PHI_NAME,), "lambda is 1 / phi"))
    target = taken.get("lambda_target")
    if target is not None and target.is_phi:
        auxiliary.append(Proposal("phi_target", target, ()))
        derived.append(Derived("lambda_target", 1.0, (), ("phi_target",), "lambda is 1 / phi"))
    per_stroke = STROKES_MG_PER_KG_H / cylinders
    why = f"kg/h and speed to mg per stroke of one of {cylinders} cylinders"
    has_speed = "engine_speed_rpm" in taken
    flow = _best(found.get(FUEL_FLOW_NAME, []))
    if "fuel_mass_mg" not in taken and flow is not None and has_speed:
        others = found[FUEL_FLOW_NAME][1:]
        auxiliary.append(Proposal(FUEL_FLOW_NAME, flow, tuple(others)))
        derived.append(
            Derived("fuel_mass_mg", per_stroke, (FUEL_FLOW_NAME,), ("engine_speed_rpm",), why)
        )
    if "air_mass_mg" not in taken and "maf_kg_h" in taken and has_speed:
        derived.append(
            Derived("air_mass_mg", per_stroke, ("maf_kg_h",), ("engine_speed_rpm",), why)
        )
    made = {d.name for d in derived}
    kept = tuple(
        Proposal(p.name, None, p.others, "derived below") if p.name in made else p for p in signals
    )
    return Proposals(kept, tuple(auxiliary), tuple(derived), database)


def _assign(found: Mapping[str, list[Candidate]], taken: dict[str, Candidate]) -> None:
    """Give each canonical signal its best, the surest first, no place twice."""
    bests = [(name, best) for name, each in found.items() if (best := _best(each)) is not None]
    used: set[tuple[str, str]] = set()
    for name, best in sorted(bests, key=lambda item: (-item[1].confidence, item[0])):
        place = (best.message.name, best.signal.name)
        if name != FUEL_FLOW_NAME and place not in used:
            used.add(place)
            taken[name] = best


def _best(found: list[Candidate]) -> Candidate | None:
    """Return the candidate that can be proposed, None if none is sure enough or two are."""
    return None if _doubt(found) else found[0]


def _doubt(found: list[Candidate]) -> str:
    """Return why nothing of this is proposed, "" if the first is."""
    if not found:
        return NOTHING
    open_ones = [c for c in found if not c.blocked]
    if not open_ones:
        return "only of another sensor or bank, as it seems"
    best = open_ones[0]
    if best.confidence < SURE:
        return "not sure enough"
    from_here = RIVAL if best.name in OF_ONE_SENSOR else SURE
    rivals = [c for c in open_ones[1:] if c.confidence >= from_here]
    return _rivalry(best, rivals) if rivals else ""


def _rivalry(best: Candidate, rivals: list[Candidate]) -> str:
    """Return why the best may not be taken beside the others, "" if it may."""
    if best.name in OF_ONE_SENSOR:
        if best.is_stated and not any(c.is_stated for c in rivals):
            return ""
        return "AMBIGUOUS: several sensors, say which is the upstream one of bank 1"
    close = [c for c in rivals if best.confidence - c.confidence < MARGIN]
    if any(_bare(c) != _bare(best) for c in close):
        return "AMBIGUOUS: these are about equally likely"
    return ""


def _bare(candidate: Candidate) -> str:
    """Return the name by which a signal is known in several messages."""
    own = candidate.signal.name.lower().replace(candidate.message.name.lower(), "")
    return own.strip("_0123456789")


def _proposal(name: str, found: list[Candidate], taken: Mapping[str, Candidate]) -> Proposal:
    best = taken.get(name)
    if best is not None:
        return Proposal(name, best, tuple(c for c in found if c is not best)[: SHOWN - 1])
    note = _doubt(found) or f"{found[0].place} is taken for another signal"
    return Proposal(name, None, tuple(found[:SHOWN]), note)
