"""Rows of the detection matrix: what the monitor and the literature's rules say of every trial.

A chunk holds some vehicles: first their healthy drives, from which their references learn, one
drive of each vehicle after the other; then all their trials, with an empty fault memory each.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.studies.rules.alarms import alarms, fitted
from benchmarks.studies.rules.windows import Rule
from benchmarks.studies.runner import Found, Place
from benchmarks.studies.sensor.drive import samples
from benchmarks.studies.sensor.plan import (
    Matrix,
    Trial,
    calibration,
    reference_drives,
    refuse_used,
    trials,
)
from monitor.base.config import Config
from monitor.base.errors import O2Error
from monitor.base.types import SampleBlock
from monitor.judge.enable import CONDITIONS
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from training.dyno import ecu
from training.jobs import parallel
from training.limits.judging import Judged, RecordingJudge

SIDE_BY_SIDE: Final = 32  # drives judged at once; the windows of one take some megabytes
VEHICLES: Final = 5  # of a chunk


@dataclass(frozen=True, slots=True)
class Bench:
    """Model, configuration and rules of the literature."""

    model: Path
    config: Config
    rules: dict[str, Rule] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Chunk:
    """Drives of some vehicles: healthy ones in rounds with one of each vehicle, then the trials."""

    rounds: tuple[tuple[Trial, ...], ...]
    trials: tuple[Trial, ...]

    @property
    def count(self) -> int:
        """Return the number of drives."""
        return sum(map(len, self.rounds)) + len(self.trials)


def chunks(matrix: Matrix, model: Path) -> dict[str, Chunk]:
    """Return all drives of a matrix in chunks, by the chunk's name.

    Raises UsageError for an impossible plan, or if the model or the rules were fitted with one of
    the vehicles or seeds.
    """
    planned, references = trials(matrix), reference_drives(matrix)
    recordings = Model.load(model).card.recordings
    every = [*planned, *(drive for own in references for drive in own)]
    refuse_used(every, [recording.path for recording in recordings])
    found = {}
    for i in range(0, matrix.vehicles, VEHICLES):
        first = matrix.first_vehicle + i
        own = tuple(t for t in planned if first <= t.vehicle < first + VEHICLES)
        rounds = tuple(zip(*references[i : i + VEHICLES], strict=True))
        found[f"vehicles_{first:05d}"] = Chunk(rounds, own)
    return found


def run(
    matrix: Matrix, planned: dict[str, Chunk], model: Path, config: Config, place: Place
) -> None:
    """Drive and judge every chunk that the place does not hold yet."""
    bench = Bench(model, config)
    if place.lacks(planned):
        bench = replace(bench, rules=_rules(matrix, bench, place.jobs))
    place.do(_rows, bench, planned)


def _rules(matrix: Matrix, bench: Bench, jobs: int) -> dict[str, Rule]:
    good, bad = calibration(matrix)
    every = [*good, *bad]
    n = SIDE_BY_SIDE
    parts = {str(i): every[i : i + n] for i in range(0, len(every), n)}
    found = dict(parallel.run(_windows, bench, parts.items(), jobs=jobs))
    windows = [drive for key in parts for drive in found[key]]
    return fitted(windows[: len(good)], windows[len(good) :], _limits(bench))


def _windows(bench: Bench, drives: Sequence[Trial]) -> list[list[WindowJudged]]:
    """Return a list of windows for every drive."""
    return [judged.windows for _, judged in _judge(drives, bench, [None] * len(drives))]


def _rows(bench: Bench, chunk: Chunk) -> Found:
    rows: list[dict[str, Any]] = []
    known: dict[int, Reference] = {}
    n = SIDE_BY_SIDE
    batches = [chunk.trials[i : i + n] for i in range(0, len(chunk.trials), n)]
    for drives in (*chunk.rounds, *batches):
        own = [known.get(trial.vehicle) for trial in drives]
        found = _judge(drives, bench, own)
        for trial, reference, (block, judged) in zip(drives, own, found, strict=True):
            rows.append(row(trial, block, judged, bench.rules))
            if trial.kind == "reference":
                known[trial.vehicle] = learn(reference, judged, bench.config)
    return {"rows": rows}


def _judge(
    drives: Sequence[Trial], bench: Bench, references: Sequence[Reference | None]
) -> list[tuple[SampleBlock, Judged]]:
    """Return samples and verdict of every drive; an error names the drive."""
    model, bus_map, limits = _model(bench.model), ecu.own_bus(), _limits(bench)
    blocks: list[SampleBlock] = []
    where = ""
    try:
        for trial in drives:
            where = trial.name
            blocks.append(samples(trial, bus_map, model.card.period_ns))
        where = f"{drives[0].name} to {where}"
        judged = judge_drives(blocks, bus_map.names, model, limits, bench.config, references)
    except O2Error:  # the model cannot judge these drives
        raise
    except Exception as error:
        raise RuntimeError(f"{where}: {type(error).__name__}: {error}") from error
    return list(zip(blocks, judged, strict=True))


def judge_drives(
    blocks: Sequence[SampleBlock],
    names: Sequence[str],
    model: Model,
    limits: Limits,
    config: Config,
    references: Sequence[Reference | None],
) -> list[Judged]:
    """Return the verdicts on drives, with an empty fault memory for every drive.

    names : column names of the blocks
    references : one per drive, the reference of its vehicle; None means a new reference
    """
    known = [reference or Reference() for reference in references]
    return RecordingJudge(names, model, limits, config).judge(blocks, references=known)


def learn(reference: Reference | None, judged: Judged, config: Config) -> Reference:
    """Return the vehicle's reference after one more drive, by the monitor's rule."""
    known = reference or Reference()
    return known if judged.seen is None else known.learn(judged.seen, config.bias)


@lru_cache(maxsize=1)
def _model(path: Path) -> Model:
    return Model.load(path)


def _limits(bench: Bench) -> Limits:
    return Limits.from_card(_model(bench.model).card, bench.config, bench.model.name)


def row(trial: Trial, block: SampleBlock, judged: Judged, rules: dict[str, Rule]) -> dict[str, Any]:
    """Return the answers of the monitor and the literature's rules to a trial, as JSON values."""
    period_s = float(np.diff(block.t_ns[:2])[0]) / 1e9
    enabled_s = np.cumsum(judged.enabled) * period_s
    windows = judged.windows

    def times_s(t_ns: int) -> tuple[float, float]:
        """Return the seconds of driving and of enabled driving up to ``t_ns``."""
        k = int(np.searchsorted(block.t_ns, t_ns, side="right")) - 1
        return round((t_ns - int(block.t_ns[0])) / 1e9, 3), round(float(enabled_s[k]), 3)

    first = min((d.t_ns for d in judged.dtcs), default=None)
    driving, enabled = (None, None) if first is None else times_s(first)
    found = alarms(windows, rules)
    not_held = 1.0 - judged.conditions.mean(axis=0)
    return trial.as_row() | {
        "completed": judged.completed,
        "codes": [d.code for d in judged.dtcs],
        "faults": sorted({d.fault for d in judged.dtcs}),
        "also": sorted({name for d in judged.dtcs for name in d.also}),
        "states": [d.state for d in judged.dtcs],
        "first_code_driving_s": driving,
        "first_code_enabled_s": enabled,
        "driving_s": round(len(block.t_ns) * period_s, 3),
        "enabled_s": round(float(enabled_s[-1]), 3),
        "windows": len(windows),
        "inconclusive": sum(w.outcome == "inconclusive" for w in windows),
        "not_held": {
            name: round(float(x), 5) for name, x in zip(CONDITIONS, not_held, strict=True)
        },
        "alarms_enabled_s": {
            name: None if a.second is None else times_s(windows[a.second].window.t_end_ns)[1]
            for name, a in found.items()
        },
        "failed_windows": {"monitor": sum(w.outcome == "failed" for w in windows)}
        | {name: a.failed for name, a in found.items()},
    }
