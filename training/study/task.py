"""Task of the study: recordings by use, signals and settings."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from training.recordings.recording import Recording, check_each_once
from training.recordings.samples.preparation import Prepared, prepare, problems
from training.study.narx.candidates import CANDIDATES

Parts = dict[str, Any]  # results of the steps by their names
LAGS = 5  # samples, from the paper; stretches below 8 times the lags are left out, as in ``fit``


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings that bound the effort of the study."""

    starts: int = 3
    iterations: int = 200  # largest number of epochs of a series-parallel training
    n_samples: int = 20_000  # largest number of training samples of one of the 29 models
    budget_minutes: float = 10.0  # of the free structure; other trainings get a share of it
    seed: int = 0
    tune_best: int = 5  # models that are tuned in closed loop
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
    def period_s(self) -> float:
        """The sample period of all recordings."""
        return self.recordings[0].period_ns / 1e9

    @property
    def folder(self) -> Path:
        """Folder of the finished parts."""
        return self.out / "parts"

    def check(self) -> None:
        """Raise RecordingError or UsageError if recordings or settings cannot be used together."""
        every = (*self.recordings, *self.test, *self.faulty, *self.steady)
        names = (*self.inputs, self.output)
        for _, error in problems(every, self.inputs, self.output):
            raise error
        for r in every:
            known = np.isfinite([r.column(name) for name in names])  # raises for a missing signal
            if not any(r is f for f in self.faulty) and not known.all(axis=0).any():
                raise RecordingError(f"{r.path}: no sample has {', '.join(names)} all valid")
        for trained in filter(None, (self.recordings, self.steady)):  # steady ones may be of these
            check_each_once((*trained, *self.test, *self.faulty))
        strange = {*self.settings.models} - {c.number for c in CANDIDATES}
        if strange:
            listed = ", ".join(map(str, sorted(strange)))
            raise UsageError(f"model {listed}: wanted numbers 1 to {len(CANDIDATES)}")

    def digest(self, *, whole: bool) -> str:
        """Return the hash of recordings, signals and settings that a part depends on.

        whole : include held-out, faulty and steady recordings
        """
        used = [self.recordings]
        used += [self.test, self.faulty, self.steady] if whole else []
        tree = {
            "recordings": [[r.read_sha256 for r in each] for each in used],
            "signals": [self.inputs, self.output],
            "period_ns": self.recordings[0].period_ns,
            "settings": asdict(self.settings),
        }
        return hashlib.sha256(json.dumps(tree).encode()).hexdigest()


def source(recordings: Sequence[Recording]) -> str:
    """Return ``simulated``, ``recorded`` or both in words, by the recordings' manifests."""
    simulated = [r.entry.get("source") == "simulated" for r in recordings]
    if all(simulated):
        return "simulated"
    return "simulated and recorded" if any(simulated) else "recorded"
