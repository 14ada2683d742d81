"""One case: its recordings made, the workflow asked, the answer as a row.

The gap of a case is what it adds to the base's held-out squared error, in phi on scored samples:
sqrt(max(0, MSE with what is hidden - MSE without)), both of the base with what it learned on the
vehicle's healthy recordings, on the same drives with the same seeds. The noise is what the naming's
ceiling leaves of the healthy recordings' residual (``scoring.floor_phi``), one value per vehicle.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from training.chain import Constants
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
        return row | _answered(case, study, vehicle)
    except Exception as error:  # one case must not end a study of many hours
        return row | {"error": f"{type(error).__name__}: {error}"}


def _answered(case: Case, study: Study, vehicle: Vehicle) -> Row:
    hidden = drive.recordings(case, study.duration_s)
    began_s = time.perf_counter()
    found = ask(hidden, vehicle, 2 if case.kind == "two" else 1)
    took_s = time.perf_counter() - began_s
    without = found.rmse_before
    if case.hidden or case.fault:
        without = _before(drive.recordings(case, study.duration_s, hidden=False), vehicle)
    excess = found.rmse_before**2 - without**2
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
        "excess_before": excess,
        "excess_after": after**2 - without**2,
        "gap": max(excess, 0.0) ** 0.5,
        "gap_over_noise": max(excess, 0.0) ** 0.5 / vehicle.noise_phi,
        "seconds": took_s,
    }


def _before(recordings: Sequence[Recording], vehicle: Vehicle) -> float:
    """Return the base's held-out RMSE in phi, as the naming works it out."""
    state = begin(_drives(recordings), vehicle.known, vehicle.known.base)
    return held_out_rmse(state.case, state.current)


def _drives(recordings: Sequence[Recording]) -> list[Drive]:
    return [drives.from_recording(each) for each in recordings]
