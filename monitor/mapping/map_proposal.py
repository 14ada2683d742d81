"""The signal map that is proposed for a database, with the reason of every line."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Final

from cantools.database.can import Database, Message, Signal

from monitor.base.signals import OWN
from monitor.base.types import FloatArray
from monitor.decode.log_blocks import keys_of
from monitor.decode.signal_map import LONGEST_TIMEOUT_S, Derived
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks
from monitor.judge.causes.causes import timeout_of
from monitor.mapping.fit import ANY, Description, fit_of
from monitor.mapping.proposal import Proposal, SignalCandidate, comment, entries, propose, toml
from monitor.mapping.recording import Observed, ShownSignals, mappable
from monitor.mapping.vocabulary import FUEL_FLOW_NAME, QUANTITIES, WORDS

SLOW_MS: Final = 1_000_000  # cycle of a message that says none, or more
ALL_ONES: Final = frozenset(2.0**bits - 1.0 for bits in range(65))
ENGINE: Final = QUANTITIES.keys() & {"manifold_temperature_degc", *WORDS["varying"]}
NO_ENGINE: Final = "perhaps of an electric car: nothing says that there is an engine"
ELECTRIC: Final = ["fuel_cut", "coolant_temperature_degc", "engine_torque_nm", "battery_voltage_v"]
CONSIDERED: Final = 8  # candidates of each signal that are compared with the recording
PHI_NAMES: Final = {"lambda_measured": "phi_measured", "lambda_target": "phi_target"}
FLOWS: Final = {"fuel_mass_mg": FUEL_FLOW_NAME, "air_mass_mg": "maf_kg_h"}
STROKES_MG_PER_KG_H: Final = 1e6 / 30.0  # kg/h to mg per stroke: this / cylinders / speed
_HEAD: Final = files("monitor.mapping").joinpath("map.template").read_text("utf-8")
DERIVED: Final = "derived below"


@dataclass(frozen=True, slots=True)
class MapProposal:
    """A whole map to confirm."""

    signals: tuple[Proposal, ...]  # one per canonical signal, in their order

    @property
    def found(self) -> tuple[SignalCandidate, ...]:
        """Return the signals that are mapped to a canonical one directly."""
        return tuple(p.best for p in self.signals if p.best is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the canonical signals that the map provides."""
        return tuple(p.name for p in self.signals if p.best or p.note == DERIVED)


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
        recording = ShownSignals(blocks, likeliest, database)
        proposals = propose(candidates(database, recording.observed))
        guards = recording.guards({p.best.place for p in proposals.values() if p.best})
    auxiliary, derived = _made(proposals, cylinders)
    signals = tuple(proposals[s.name] for s in OWN)
    head = _HEAD.format(dbc=dbc.name, log=f" and checked with {log.name}" if log else "")
    changed = ["Changed or left out to read the database:", *notes] if notes else []
    sections = {
        "messages": [f"{toml(name)} = {toml(held)}" for name, held in guards.items()],
        "signals": entries(signals),
        "auxiliary": entries(auxiliary),
        "derived": [f"{each.name} = {toml({**asdict(each), 'name': ''})}" for each in derived],
    }
    lines = [*map(comment, [*head.splitlines(), *changed])]
    for title, rows in sections.items():
        lines += ["", f"[{title}]", *rows] if rows else []
    return "\n".join(lines) + "\n", MapProposal(signals)


def _made(proposals: dict[str, Proposal], cylinders: int) -> tuple[list[Proposal], list[Derived]]:
    """Return what is made of others, where nothing carries it itself, and of what."""
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
        proposals[each.name] = replace(proposals[each.name], note=DERIVED)
    return auxiliary, derived


def candidates(
    database: Database, observed: Mapping[str, Observed] | None = None
) -> dict[str, list[SignalCandidate]]:
    """Return the candidates of every canonical signal and of the fuel flow.

    observed : signals of a recording, by message and name; no others are candidates then
    """
    found: dict[str, list[SignalCandidate]] = {name: [] for name in QUANTITIES}
    for place, message, signal in mappable(database):
        if observed is not None and place not in observed:
            continue
        values, interval_s = observed[place] if observed else (None, None)
        described = _described(message, signal, values)
        cycle_ms = float(min(max(message.cycle_time or SLOW_MS, 0), SLOW_MS))
        timeout_s = _timeout_s(message, interval_s, cycle_ms)
        is_other = "eng" not in message.name.lower()  # the engine's own message comes first
        for name, each in found.items():
            if fit := fit_of(name, described):
                order = cycle_ms, abs(described.step * fit.factor), is_other, place
                way = {"factor": fit.factor, "offset": fit.offset, "timeout_s": timeout_s}
                entry = {"message": message.name, "signal": signal.name, **way}
                each.append(SignalCandidate(name, place, fit, entry, order))
    if all(each.fit.doubt for name in ENGINE for each in found[name]):
        for name in ELECTRIC:
            found[name] = [replace(each, fit=each.fit.doubted(NO_ENGINE)) for each in found[name]]
    return found


def _timeout_s(message: Message, interval_s: float | None, cycle_ms: float) -> float:
    """Return how old a value may be, by the recording, else by the stated cycle time."""
    if interval_s is not None:
        return timeout_of(interval_s)
    if cycle_ms < SLOW_MS:  # five cycles
        return round(min(max(5 * cycle_ms / 1000, 0.3), LONGEST_TIMEOUT_S), 3)
    return 3.0 if message.is_multiplexed() else 0.5  # answers to requests come slowly


def _described(message: Message, signal: Signal, values: FloatArray | None) -> Description:
    """Return what a database says about a signal."""
    least = -(1 << (signal.length - 1)) if signal.is_signed else 0
    raw = least, least + (1 << signal.length) - 1
    low, high = sorted(float(each) * float(signal.scale) + float(signal.offset) for each in raw)
    carried = stated = ANY if signal.is_float else (low, high)
    if signal.minimum is not None and signal.maximum is not None:
        low, high = float(signal.minimum), float(signal.maximum)
        # as an editor fills the range in: that of a number of bits
        is_filler = high in ALL_ONES and low in (0.0, -high, -high - 1.0)
        stated = (low, high) if low < high and not is_filler else carried
    return Description(
        name=signal.name,
        unit=(signal.unit or "").strip(),
        message=message.name,
        comment=signal.comment or "",
        carried=carried,
        stated=stated,
        step=0.0 if signal.is_float else float(signal.scale),
        choices={int(k): str(v).lower() for k, v in (signal.choices or {}).items()},
        values=values,
    )
