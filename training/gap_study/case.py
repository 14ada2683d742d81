"""One case: its recordings made, the workflow asked, the answer as a row.

The gap of a case is how far what is hidden moves the base's error: the RMS, in phi over samples
scored in both, of the difference between its error on the drives and on the same drives and seeds
with nothing hidden. The noise is what the naming's ceiling leaves of the residual of the vehicle's
healthy recordings (``scoring.floor_phi``). The excess, of which an answer takes a share away, is
the mean squared error on held-out blocks, less that of the drives with nothing hidden.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from monitor.types import FloatArray
from training.chain import Constants, base_path, simulate
from training.gap import drives, scoring
from training.gap.begin import begin
from training.gap.drives import Drive
from training.gap.fitting import held_out_rmse
from training.gap.healthy import Healthy, learn
from training.gap.naming import name
from training.gap.verdict import Naming
from training.gap_study import drive
from training.gap_study.plan import Case, Study, healthy_parts
from training.recordings import Recording

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Vehicle:
    """What all cases of one vehicle share."""

    number: int
    known: Healthy
    noise_phi: float


def prepare(study: Study, number: int) -> Vehicle:
    """Return what a vehicle's healthy recordings teach."""
    made = drive.healthy(healthy_parts(study, number), number, study.duration_s)
    driven = _drives(made)
    known = learn(driven, Constants())
    state = begin(driven, known, known.base)
    return Vehicle(number, known, scoring.floor_phi(state.case, state.current))


def ask(recordings: Sequence[Recording], vehicle: Vehicle, steps: int) -> Naming:
    """Return the workflow's answer to the recordings."""
    return name(_drives(recordings), vehicle.known, steps=steps)


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
    began_s = time.perf_counter()
    found = ask(recordings, vehicle, 2 if case.kind == "two" else 1)
    took_s = time.perf_counter() - began_s
    without, gap = found.rmse_before, 0.0
    if case.hidden or case.fault:
        driven = _drives(drive.recordings(case, study.duration_s, hidden=False))
        without, gap = _before(driven, vehicle), moved_phi(_drives(recordings), driven, vehicle)
    after = found.rmse_before if found.rmse_after is None else found.rmse_after
    ranking = found.ranking
    return {
        "verdict": found.verdict,
        "names": [e.name for e in found.effects] if found.verdict == "named" else [],
        "among": [e.name for e in found.effects] if found.verdict == "ambiguous" else [],
        "suspected": found.suspected,
        "best": ranking[0].name if ranking else None,
        "runner_up": ranking[1].name if len(ranking) > 1 else None,
        "score": ranking[0].score if ranking else None,
        "t": ranking[0].t if ranking else None,
        "adequacy": ranking[0].adequacy if ranking else None,
        "win": ranking[1].win if len(ranking) > 1 else None,
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


def moved_phi(hidden: Sequence[Drive], nothing: Sequence[Drive], vehicle: Vehicle) -> float:
    """Return how far the base's error differs between two series of the same drives, RMS in phi."""
    moved = []
    for a, b in zip(hidden, nothing, strict=True):
        both = a.scored & b.scored
        moved.append((_error(a, vehicle) - _error(b, vehicle))[both])
    return float(np.sqrt(np.mean(np.concatenate(moved) ** 2)))


def _error(drive: Drive, vehicle: Vehicle) -> FloatArray:
    path = base_path(vehicle.known.base, drive.signals)
    return simulate(path, drive.period_s) - drive.phi_measured


def _before(driven: Sequence[Drive], vehicle: Vehicle) -> float:
    """Return the base's held-out RMSE in phi, as the naming works it out."""
    state = begin(driven, vehicle.known, vehicle.known.base)
    return held_out_rmse(state.case, state.current)


def _drives(recordings: Sequence[Recording]) -> list[Drive]:
    return [drives.from_recording(each) for each in recordings]
