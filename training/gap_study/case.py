"""One case: its recordings made, the workflow asked, the answer as a row.

The gap of a case is how far what is hidden moves the error of the base that was fitted to the
vehicle's healthy recordings: the RMS, in phi over samples scored in both, of the difference between
its error on the drives and on the same drives and seeds with nothing hidden. The noise is what the
naming's ceiling leaves of the residual of the healthy recordings (``scoring.floor_phi``). The
excess, of which an answer takes a share away, is the mean squared error on held-out blocks, less
that of the same base, fitted alike, on the drives with nothing hidden.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from monitor.types import FloatArray
from training.gap import scoring
from training.gap.begin import begin
from training.gap.drives import from_recording
from training.gap.fitting import held_out_rmse
from training.gap.healthy import Healthy, learn
from training.gap.naming import name
from training.gap.predicted import predicted_phi
from training.gap.verdict import Naming
from training.gap_study import drive
from training.gap_study.base import constants_of, drives_of, fit_base
from training.gap_study.plan import Case, Study, healthy_parts
from training.recordings import Recording

Row = dict[str, Any]
RANKED: Final = 5  # candidates of the last step that a row keeps


@dataclass(frozen=True, slots=True)
class Vehicle:
    """What all cases of one vehicle share."""

    number: int
    model: Path  # the base, fitted to the healthy recordings
    healthy: tuple[Recording, ...]
    known: Healthy
    noise_phi: float


def prepare(study: Study, number: int, model: Path) -> Vehicle:
    """Return what a vehicle's healthy recordings teach; the base goes to the file ``model``."""
    made = drive.healthy(healthy_parts(study, number), number, study.duration_s)
    fit_base(study.base, made, model)
    driven = drives_of(model, made)
    known = learn(driven, constants_of(model))
    state = begin(driven, known, known.base)
    noise_phi = scoring.floor_phi(state.case, state.current)
    return Vehicle(number, model, tuple(made), known, noise_phi)


def ask(model: Path, recordings: Sequence[Recording], known: Healthy, steps: int) -> Naming:
    """Return the workflow's answer to the recordings."""
    return name(drives_of(model, recordings), known, steps=steps)


def run(case: Case, study: Study, vehicle: Vehicle | str) -> Row:
    """Return the case's row; an error of it, or of its vehicle, is part of the row."""
    if isinstance(vehicle, str):
        return case.as_row() | {"noise": None, "error": vehicle}
    row = case.as_row() | {"noise": vehicle.noise_phi, "error": None}
    try:
        answered = _answered(case, study, vehicle)
        if wrong := [k for k, v in answered.items() if isinstance(v, float) and not isfinite(v)]:
            raise ValueError(f"{', '.join(wrong)} not finite")
        return row | answered
    except Exception as error:  # one case must not end a study of many hours
        return row | {"error": f"{type(error).__name__}: {error}"}


def _answered(case: Case, study: Study, vehicle: Vehicle) -> Row:
    recordings = drive.recordings(case, study.duration_s)
    nothing = recordings
    if case.hidden or case.fault:
        nothing = drive.recordings(case, study.duration_s, hidden=False)
    with TemporaryDirectory() as folder:
        base = _base(study, vehicle, recordings, Path(folder) / "base.onnx")
        began_s = time.perf_counter()
        found = ask(base.model, recordings, base.known, 2 if case.kind == "two" else 1)
        took_s = time.perf_counter() - began_s
        without = found.rmse_before
        if nothing is not recordings:
            reference = _base(study, vehicle, nothing, Path(folder) / "reference.onnx")
            without = _before(reference, nothing)
    gap = moved_phi(vehicle.model, recordings, nothing)
    after = found.rmse_before if found.rmse_after is None else found.rmse_after
    ranking = found.ranking
    return {
        "verdict": found.verdict,
        "names": [e.name for e in found.effects] if found.verdict == "named" else [],
        "among": [e.name for e in found.effects] if found.verdict == "ambiguous" else [],
        "suspected": found.suspected,
        "runner_up": ranking[1].name if len(ranking) > 1 else None,
        "win": ranking[1].win if len(ranking) > 1 else None,
        "ranking": [
            {k: getattr(c, k) for k in ("name", "score", "t", "adequacy", "win")}
            for c in ranking[:RANKED]
        ],
        "rmse_before": found.rmse_before,
        "rmse_after": found.rmse_after,
        "rmse_without": without,
        "noise_floor": found.noise_floor,
        "explained_share": found.explained_share,
        "excess_before": found.rmse_before**2 - without**2,
        "excess_after": after**2 - without**2,
        "gap": gap,
        "gap_over_noise": gap / vehicle.noise_phi,
        "seconds": took_s,
    }


def moved_phi(model: Path, hidden: Sequence[Recording], nothing: Sequence[Recording]) -> float:
    """Return how far a model's error differs between two series of the same drives, RMS in phi."""
    a, b = _errors(model, hidden), _errors(model, nothing)
    moved = np.concatenate([x - y for x, y in zip(a, b, strict=True)])
    return float(np.sqrt(np.nanmean(moved**2)))


def _errors(model: Path, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Return the model's error over each recording, (n,) in phi, NaN where not scored."""
    run = predicted_phi(model, recordings)
    made = [from_recording(each) for each in recordings]
    return [
        np.where(d.scored, phi - d.phi_measured, np.nan) for d, phi in zip(made, run, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _Base:
    """A base model and what it misses on the vehicle's healthy recordings."""

    model: Path
    known: Healthy


def _base(study: Study, vehicle: Vehicle, recordings: Sequence[Recording], out: Path) -> _Base:
    """Return the vehicle's base, or one fitted to the recordings themselves."""
    if not study.fitted_with_effect:
        return _Base(vehicle.model, vehicle.known)
    fit_base(study.base, recordings, out)
    return _Base(out, learn(drives_of(out, vehicle.healthy), constants_of(out)))


def _before(base: _Base, recordings: Sequence[Recording]) -> float:
    """Return the base's held-out RMSE in phi, as the naming works it out."""
    state = begin(drives_of(base.model, recordings), base.known, base.known.base)
    return held_out_rmse(state.case, state.current)
