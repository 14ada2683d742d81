"""Rows of the catalyst matrix: truth, what the monitor says, and the indices of the rules."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from benchmarks.studies.behind import rules
from benchmarks.studies.behind.drive import PERIOD_S, drive, judged
from benchmarks.studies.behind.plan import CatalystMatrix, CatalystTrial, trials
from benchmarks.studies.runner import Found, Place
from monitor.base.config import Config

CHUNK: Final = 8
LIMITS: Final = "rule_limits"  # a chunk without drives


@dataclass(frozen=True, slots=True)
class Setting:
    """What a worker needs beside its trials."""

    config: Config
    seconds: float


def run(matrix: CatalystMatrix, config: Config, place: Place) -> None:
    """Set the rules' limits, and drive and judge every chunk that the place does not hold yet."""
    planned, setting = trials(matrix), Setting(config, matrix.seconds)
    place.do(_limits, setting, {LIMITS: None})
    parts = range(0, len(planned), CHUNK)
    place.do(_rows, setting, {f"drives_{i:05d}": planned[i : i + CHUNK] for i in parts})


def _limits(setting: Setting, _: None) -> Found:
    return {"rows": [{"kind": LIMITS, **rules.limits(setting.seconds)}]}


def _rows(setting: Setting, chunk: Sequence[CatalystTrial]) -> Found:
    """Drive and judge a chunk; an error names the drive."""
    rows = []
    for trial in chunk:
        try:
            rows.append(row(trial, setting.config, setting.seconds))
        except Exception as error:
            where = f"catalyst drive {trial.number}, vehicle {trial.vehicle}"
            raise RuntimeError(f"{where}: {type(error).__name__}: {error}") from error
    return {"rows": rows}


def row(trial: CatalystTrial, config: Config, seconds: float) -> dict[str, Any]:
    """Return one drive's truth, what the monitor says of it, and the indices of the rules."""
    names, values, true_g = drive(trial, seconds)
    indices = rules.indices(names, values, PERIOD_S)
    return (
        trial.as_row()
        | {"true_g": true_g, "driving_s": round(len(values) * PERIOD_S, 3)}
        | judged(names, values, config)
        | {"rules": {k: v if math.isfinite(v) else None for k, v in indices.items()}}
    )
