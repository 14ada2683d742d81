"""Task of the study: recordings, signals and settings, and the samples that its parts use."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.files.manifest import source_of
from monitor.base.types import FloatArray
from monitor.model.step import to_model_units
from training.recordings.outliers import outlier_mask
from training.recordings.preparation import (
    OTHER_WEIGHT,
    Prepared,
    Role,
    Samples,
    Segment,
    enabled_rows,
    prepare,
)
from training.recordings.recording import Recording
from training.recordings.rows import runs
from training.study.narx.candidates import CANDIDATES, Candidate

LAGS = 5  # samples, from the paper; stretches below 8 times the lags are left out, as in ``fit``


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings that bound the effort of the study."""

    starts: int = 3
    iterations: int = 200  # largest number of epochs of a series-parallel training
    n_samples: int = 20_000  # largest number of training samples of one of the 29 models
    budget_minutes: float = 10.0  # of the free structure; other trainings get a share of it
    seed: int = 0
    models: tuple[int, ...] = ()  # numbers of the trained models, all 29 if empty


@dataclass(frozen=True)
class Task:
    """Recordings by use, signals and settings."""

    recordings: tuple[Recording, ...]  # for training, choice and test, in blocks
    test: tuple[Recording, ...]  # held-out drives of the healthy vehicle
    faulty: tuple[Recording, ...]
    steady: tuple[Recording, ...]  # at steady operating points
    inputs: tuple[str, ...]
    output: str
    out: Path
    settings: Settings
    jobs: int = 2
    scheduler: str | None = None

    @cached_property
    def data(self) -> Prepared:
        """The training recordings, prepared like in ``fit``."""
        return prepare(
            self.recordings, self.inputs, self.output, lags=LAGS, seed=self.settings.seed
        )

    @property
    def models(self) -> tuple[Candidate, ...]:
        """The models of the NARX study to train."""
        wanted = self.settings.models
        return tuple(c for c in CANDIDATES if c.number in wanted or not wanted)

    @property
    def folder(self) -> Path:
        """Folder of the finished parts."""
        return self.out / "parts"

    def check(self) -> None:
        """Raise RecordingError or UsageError if recordings or settings cannot be used together."""
        first = self.recordings[0]
        for r in (*self.recordings, *self.test, *self.faulty, *self.steady):
            for name in (*self.inputs, self.output):
                r.column(name)  # raises for a missing signal
            if r.period_ns != first.period_ns:
                raise RecordingError(
                    f"{r.path}: sample period {r.period_ns / 1e9:g} s, {first.path} has "
                    f"{first.period_ns / 1e9:g} s; bring them to one grid with --period"
                )
        for r in (*self.recordings, *self.test, *self.steady):
            valid = [np.isfinite(r.column(name)) for name in (*self.inputs, self.output)]
            if not np.all(valid, axis=0).any():
                raise RecordingError(
                    f"{r.path}: no sample has {', '.join((*self.inputs, self.output))} all valid"
                )
        known = {r.sha256: r.path for r in (*self.recordings, *self.steady)}
        for r in (*self.test, *self.faulty):
            if r.sha256 in known:
                raise UsageError(
                    f"{r.path}: is the training recording {known[r.sha256]}, too; "
                    "drives that judge must be others"
                )
        numbers = {c.number for c in CANDIDATES}
        strange = [str(n) for n in self.settings.models if n not in numbers]
        if strange:
            raise UsageError(f"model {', '.join(strange)}: wanted numbers 1 to {max(numbers)}")

    def digest(self, *, whole: bool) -> str:
        """Return the hash of recordings, signals and settings that a part depends on.

        whole : include held-out, faulty and steady recordings
        """
        used = [self.recordings]
        if whole:
            used += [self.test, self.faulty, self.steady]
        tree = {
            "recordings": [[r.read_sha256 for r in each] for each in used],
            "signals": [self.inputs, self.output],
            "period_ns": self.recordings[0].period_ns,
            "settings": asdict(self.settings),
        }
        return hashlib.sha256(json.dumps(tree).encode()).hexdigest()


def source(recordings: Sequence[Recording]) -> str:
    """Return ``simulated``, ``recorded`` or both in words, by the recordings' manifests."""
    simulated = [source_of(Path(r.path), r.sha256) == "simulated" for r in recordings]
    if all(simulated):
        return "simulated"
    return "simulated and recorded" if any(simulated) else "recorded"


def scaled_as(data: Prepared, recordings: Sequence[Recording]) -> Prepared:
    """Return other recordings in the scaling of ``data``; all samples have the role TEST.

    The inputs are those that the monitor sees, without the noise that training adds to the
    controller.
    Raises RecordingError if no stretch can be used.
    """
    names = (*data.names, data.output.name)
    parts, segments, at = [], [], 0
    for index, recording in enumerate(recordings):
        values = np.column_stack([recording.column(name) for name in names])
        for i, name in enumerate(names):
            values[outlier_mask(name, values[:, i]), i] = np.nan
        on = enabled_rows(recording)
        for first, stop in runs(np.asarray(np.isfinite(values[:, :-1]).all(axis=1))):
            if stop - first < 8 * LAGS or not np.isfinite(values[first:stop, -1]).any():
                continue
            parts.append((values[first:stop], on[first:stop]))
            segments.append(Segment(index, first, at, at + stop - first))
            at += stop - first
    if not segments:
        files = ", ".join(str(r.path) for r in recordings)
        raise RecordingError(f"{files}: no stretch of {8 * LAGS} samples with all inputs valid")
    values = np.concatenate([v for v, _ in parts])
    on = np.concatenate([o for _, o in parts])
    y = to_model_units(data.transform, values[:, -1])
    valid = np.isfinite(y)
    filled = np.interp(np.arange(len(y)), np.flatnonzero(valid), y[valid])
    samples = Samples(
        data.scaling.scale_u(values[:, :-1]),
        (filled - data.scaling.y_mean) / data.scaling.y_std,  # not clipped to the trained range
        np.where(on, 1.0, OTHER_WEIGHT) * valid,
    )
    return replace(
        data,
        samples=samples,
        segments=tuple(segments),
        enabled=on & valid,
        role=np.full(len(y), Role.TEST, dtype=np.int8),
        recordings=tuple(recordings),
    )


def as_in_use(data: Prepared) -> Prepared:
    """Return ``data`` with the inputs that the monitor sees; the roles stay."""
    return replace(scaled_as(data, data.recordings), role=data.role)


def judged_on(task: Task) -> Prepared:
    """Return the held-out drives, or the training recordings without held-out drives.

    In both cases no sample of role TEST was used to train or choose a model.
    """
    return scaled_as(task.data, task.test) if task.test else as_in_use(task.data)


def thinned(values: FloatArray, most: int) -> FloatArray:
    """Return at most ``most`` of the values (n,), evenly spread."""
    return values[:: max(1, -(-len(values) // most))]
