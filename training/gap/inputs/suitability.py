"""Conditions of recordings before a fit: no bytes twice, one grid, long enough, moving."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from monitor.base.counts import duration
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from training.gap.config import CONFIG
from training.gap.inputs.roles import Material
from training.greybox.chain import Constants, base_path, valve_phi
from training.greybox.effects import LIBRARY
from training.greybox.fit.drive import MIN_SCORED_S, NEEDED, ChainDrive
from training.healthy import base
from training.pages.numbers import percent
from training.recordings.prediction import check_period, check_signals
from training.recordings.recording import Recording, check_each_once

LIMITS: Final = CONFIG.inputs
SPEED: Final = ("engine_speed_rpm", "maf_kg_h")  # both give the charge, with it either the other


def check_files(roles: Mapping[str, Sequence[Recording]], card: ModelCard) -> dict[str, list[str]]:
    """Return the signals that the chain needs and that are missing → recordings without them.

    roles : "RECORDING", "--healthy", "--verify" → recordings
    A chain cannot do without them, a network can still be looked at.
    Raises UsageError if a recording stands twice, RecordingError if one is on another grid than the
    model, or lacks a signal of it, or, a chain's or a healthy one, of the chain.
    """
    every = [each for group in roles.values() for each in group]
    check_each_once(every)
    for each in every:
        check_period(each, card)
    if card.transform != "phi":  # no chain for other outputs than lambda
        return {}
    own_charge = base.own_charge(card)
    missing = lacking([*roles["RECORDING"], *roles["--verify"]], own_charge)
    if missing and card.kind == base.GREYBOX:
        names = sorted({name for group in missing.values() for name in group})
        raise RecordingError(
            f"{', '.join(names)}: no column or no good value of {' and '.join(missing)}, without "
            "which the chain does not run (docs/reference/signals.md has the names, --columns maps "
            "others); a network on other inputs (o2train fit --inputs) can be compared"
        )
    healthy = () if missing else roles["--healthy"]
    for signal, names in lacking(healthy, own_charge).items():
        raise RecordingError(
            f"{', '.join(names)}: healthy, without a good value of {signal}, which the recordings "
            "to be looked at have; what the model misses when healthy is learned with it"
        )
    for each in every:
        check_signals(each, card)
    return missing


def lacking(recordings: Sequence[Recording], own_charge: bool = False) -> dict[str, list[str]]:
    """Return the signals that the chain needs and that are missing → recordings without them.

    own_charge : the chain makes the air per stroke of other signals
    """
    missing: dict[str, list[str]] = {}
    for each in recordings:
        present = each.known
        names = [n for n in NEEDED if n not in present]
        if "air_mass_mg" in names and (own_charge or set(SPEED) <= present):
            names.remove("air_mass_mg")
        if not present & set(SPEED):
            names.append(SPEED[0])
        for name in names:
            missing.setdefault(name, []).append(each.path.name)
    return missing


def check_long(drives: Sequence[ChainDrive], role: str) -> None:
    """Raise RecordingError if a drive, or all together, are too short to hold blocks out."""
    each = [float(d.kept.sum()) * d.period_s for d in drives]
    if short := [d for d, own in zip(drives, each, strict=True) if own < MIN_SCORED_S]:
        raise RecordingError(f"{_names(short)}: less than {MIN_SCORED_S:.0f} s can be scored")
    seconds = sum(each)
    if seconds < LIMITS.scored_min_s:
        raise RecordingError(
            f"{_names(drives)}: {duration(seconds)} of {role} recordings can be scored in all, "
            f"{duration(LIMITS.scored_min_s)} are wanted, better several recordings of ten minutes"
        )


def check_moving(drives: Sequence[ChainDrive]) -> None:
    """Raise RecordingError if the drives stand at one operating point: nothing can be told apart.

    With closed-loop control phi at the valve moves everywhere; effects differ by the way in
    which they follow load and speed.
    """
    load, load_moves = _moves([d.signals["air_mass_mg"][d.scored] for d in drives])
    speed, speed_moves = _moves([d.signals["engine_speed_rpm"][d.scored] for d in drives])
    if max(load_moves, speed_moves) >= LIMITS.moves_min:
        return
    valve = [valve_phi(base_path(Constants(), d.signals))[d.scored] for d in drives]
    phi, phi_moves = _moves(valve)
    raise RecordingError(
        f"{_names(drives)}: no excitation, {percent(0.9)} of the samples lie within "
        f"{percent(load_moves, 1)} of {load:.0f} mg of air per stroke, "
        f"{percent(speed_moves, 1)} of {speed:.0f} rpm and {percent(phi_moves, 1)} of "
        f"phi {phi:.2f} at the valve; load or speed must move by "
        f"{percent(LIMITS.moves_min)}, better mixed driving"
    )


def poor_model_warnings(card: ModelCard) -> list[str]:
    """Return a warning if the model hardly follows its own vehicle: any verdict means little."""
    figures = card.fit.get("test", {}) | card.fit.get("test_enabled", {})  # some enable no sample
    found = figures.get("correlation", 1.0)
    if found >= LIMITS.correlation_min:
        return []
    return [
        f"the model follows blocks held out of its own training poorly (correlation {found:.2f}): "
        "what it says of recordings, and any verdict here, means little"
    ]


def seen_in_fit_warnings(card: ModelCard, material: Material) -> list[str]:
    """Return a warning if the model was fitted to recordings in which the gap is sought."""
    fitted_to = {each.sha256 for each in card.recordings}
    looked_at = (*material.recordings, *material.verify)
    names = ", ".join(each.path.name for each in looked_at if each.sha256 in fitted_to)
    if not names:
        return []
    counts = "" if material.healthy else ", and a gap that they have counts as healthy"
    return [
        f"{names}: the model was fitted to them, so its error is of drives that it knows{counts}; "
        "give other recordings"
    ]


def unlearned_effect_warnings(
    recordings: Sequence[Recording], healthy: Sequence[Recording]
) -> list[str]:
    """Return warnings of effects whose signals only the new recordings have."""
    if not healthy:
        return []
    here, there = (frozenset.intersection(*(r.known for r in g)) for g in (recordings, healthy))
    there |= {*NEEDED, *SPEED} if there & set(SPEED) else set(NEEDED)  # one gives the other
    return [
        f"{effect.name}: healthy recordings lack {', '.join(sorted(set(effect.needs) - there))}, "
        "so its score is not held against what healthy drives show"
        for effect in LIBRARY.values()
        if set(effect.needs) <= here and not set(effect.needs) <= there
    ]


def _moves(values: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the median and the width of 90 % of the values, of the median."""
    least, most = LIMITS.moves_quantiles
    low, middle, high = np.quantile(np.concatenate(values), (least, 0.5, most))
    return float(middle), float((high - low) / max(abs(middle), 1e-9))


def _names(drives: Sequence[ChainDrive]) -> str:
    return ", ".join(d.name for d in drives)
