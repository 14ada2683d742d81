"""NARX study: 29 models from several starts; the best models are tuned in closed loop.

Validation blocks decide every choice; test blocks are only reported. A killed study resumes from
the jobs stored in its directory.
"""

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from training.narx.network import Spec
from training.recordings.preparation import Prepared, Role
from training.study.narx import parallel
from training.study.narx.candidates import BAYES, CANDIDATES, LM, Candidate, same_as
from training.study.narx.models import (
    HORIZONS,
    Job,
    from_arrays,
    spec_of,
    thin,
    train_one,
    tune_one,
)
from training.study.narx.verdicts import findings, judge, rules, warnings
from training.study.task import source

VERSION = 1  # of the jobs; stored jobs of another version are not reused
SEED_STEP = 1000  # difference of the seeds of two starts, as in ``fit``


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings shared by all models."""

    starts: int
    iterations: int
    n_samples: int
    tune_best: int
    seed: int
    input_lag_start: int


def narx_study(
    data: Prepared,
    directory: Path,
    *,
    starts: int = 3,
    iterations: int = 200,
    n_samples: int = 20_000,
    tune_best: int = 5,
    jobs: int = 2,
    scheduler: str | None = None,
    seed: int = 0,
    input_lag_start: int = 1,
    candidates: Sequence[Candidate] = CANDIDATES,
) -> dict[str, Any]:
    """Return the figures of all models and starts, and of the best models after tuning.

    directory : folder of the finished jobs, two files per job
    iterations : largest number of epochs of a series-parallel training
    n_samples : largest number of training samples; whole blocks are spread over the recordings
    tune_best : number of models tuned in closed loop
    jobs, scheduler : see ``parallel.run``
    input_lag_start : smallest lag of the inputs, 0 or 1 samples
    Raises RecordingError if the samples are too few, UsageError for impossible settings.
    """
    settings = Settings(
        starts=starts,
        iterations=iterations,
        n_samples=n_samples,
        tune_best=tune_best,
        seed=seed,
        input_lag_start=input_lag_start,
    )
    began = time.monotonic()
    _check(settings, candidates)
    thinned = thin(data, n_samples)
    digest = _digest(thinned, settings)
    where: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler}
    trainings = _trainings(thinned, settings, candidates, digest)
    done = parallel.run(train_one, thinned, trainings, directory, label="models", **where)
    models = _models(thinned, candidates, trainings, done, iterations)
    ranking = _ranking(models)
    tunings = _tunings(models, ranking, trainings, settings, directory)
    tuned = parallel.run(tune_one, thinned, tunings, directory, label="closed loop", **where)
    result = _result(
        data=data,
        thinned=thinned,
        settings=settings,
        models=models,
        ranking=ranking,
        tunings=tunings,
        done=tuned,
    )
    return result | {"seconds": round(time.monotonic() - began, 1)}


def best_model(result: Mapping[str, Any], directory: Path) -> tuple[Spec, FloatArray]:
    """Return shape and weights of the model with the least free-run validation error."""
    return from_arrays(parallel.arrays_of(directory, result["best"]["weights_key"]))


def _check(settings: Settings, candidates: Sequence[Candidate]) -> None:
    if settings.starts < 1 or settings.iterations < 1 or not candidates:
        raise UsageError(
            f"{len(candidates)} models, {settings.starts} starts, {settings.iterations} "
            "iterations: at least one of each is wanted"
        )


def _trainings(
    data: Prepared, settings: Settings, candidates: Sequence[Candidate], digest: str
) -> dict[str, Job]:
    """Return the jobs by key, the longest first; equal models share their jobs."""
    n = int(((data.role == Role.TRAIN) & (data.samples.weight > 0)).sum())
    smallest = min(spec_of(data, c, settings.input_lag_start).n_weights for c in candidates)
    if n < smallest:
        raise RecordingError(
            f"{n} training samples for {smallest} weights of the smallest model are too few"
        )

    def effort(candidate: Candidate) -> int:
        order = 2 if candidate.algorithm in (LM, BAYES) else 1
        return int(spec_of(data, candidate, settings.input_lag_start).n_weights ** order)

    same = same_as(candidates)
    result = {}
    for c in sorted(candidates, key=effort, reverse=True):
        for start in range(settings.starts if c.number not in same else 0):
            seed = settings.seed + SEED_STEP * start
            job = Job(
                candidate=c,
                start=start,
                seed=seed,
                iterations=settings.iterations,
                input_lag_start=settings.input_lag_start,
            )
            result[_key("train", digest, job)] = job
    return result


def _models(
    data: Prepared,
    candidates: Sequence[Candidate],
    trainings: Mapping[str, Job],
    done: Mapping[str, dict[str, Any]],
    iterations: int,
) -> list[dict[str, Any]]:
    same = same_as(candidates)
    models = []
    for c in candidates:
        keys = [k for k, j in trainings.items() if j.candidate.training == c.training]
        starts = [{**done[k], "weights_key": k} for k in keys]
        scores = [s["validation_score"] for s in starts]
        best = min(range(len(starts)), key=lambda i: _or_inf(scores[i]))
        spec = spec_of(data, c, trainings[keys[0]].input_lag_start)
        models.append(
            {
                **asdict(c),
                "hidden": list(c.hidden),
                "name": c.name,
                "same_as": same.get(c.number),
                "n_weights": spec.n_weights,
                "starts": starts,
                "best_start": best,
            }
        )
    for model, verdict in zip(models, judge(models, iterations), strict=True):
        model["verdict"] = verdict
    return models


def _ranking(models: Sequence[Mapping[str, Any]]) -> list[int]:
    """Return the model numbers by the free-run validation error of the best start.

    Repeated models are left out.
    """
    once = [m for m in models if m["same_as"] is None]
    once.sort(key=lambda m: _or_inf(m["starts"][m["best_start"]]["validation_score"]))
    return [m["number"] for m in once]


def _tunings(
    models: Sequence[Mapping[str, Any]],
    ranking: Sequence[int],
    trainings: Mapping[str, Job],
    settings: Settings,
    directory: Path,
) -> dict[str, Job]:
    """Return the jobs that tune the best start of every one of the best models, by key."""
    by_number = {m["number"]: m for m in models}
    result = {}
    for number in ranking[: settings.tune_best]:
        model = by_number[number]
        key = model["starts"][model["best_start"]]["weights_key"]
        job = trainings[key]
        _, weights = from_arrays(parallel.arrays_of(directory, key))
        result[key.replace("train", "tune")] = replace(job, weights=tuple(weights.tolist()))
    return result


def _result(
    *,
    data: Prepared,
    thinned: Prepared,
    settings: Settings,
    models: list[dict[str, Any]],
    ranking: list[int],
    tunings: Mapping[str, Job],
    done: Mapping[str, dict[str, Any]],
) -> dict[str, Any]:
    tuned = [
        {
            "number": job.candidate.number,
            "name": job.candidate.name,
            **done[key],
            "weights_key": key,
        }
        for key, job in tunings.items()
    ]
    counted = {s["weights_key"]: s["cpu_s"] for m in models for s in m["starts"]}
    result = {
        "source": source(data.recordings),
        "inputs": [c.name for c in data.inputs],
        "output": data.output.name,
        "period_s": data.period_ns / 1e9,
        "samples": {
            "training": int((thinned.role == Role.TRAIN).sum()),
            "training_available": int((data.role == Role.TRAIN).sum()),
            "validation": int((data.role == Role.VALIDATE).sum()),
            "test": int((data.role == Role.TEST).sum()),
            "enabled_share": round(float(thinned.enabled.mean()), 4),
        },
        "settings": asdict(settings) | {"horizons": list(HORIZONS)},
        "models": models,
        "ranking": ranking,
        "tuned": tuned,
        "best": _best(models, ranking, tuned),
        "rules": rules(settings.iterations),
        "cpu_s": round(sum(counted.values()) + sum(t["cpu_s"] for t in tuned), 1),
        "warnings": warnings(data, thinned, models),
    }
    return result | {"findings": findings(result)}


def _best(
    models: Sequence[Mapping[str, Any]], ranking: Sequence[int], tuned: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Return the best model, before or after tuning.

    Models that forget their history come first; among them the free-run validation error decides.
    """
    found = []
    for t in tuned:
        model = next(m for m in models if m["number"] == t["number"])
        keys = {"before": model["starts"][t["start"]]["weights_key"], "after": t["weights_key"]}
        found += [
            {
                "number": t["number"],
                "name": t["name"],
                "tuned": when == "after",
                "weights_key": key,
                "figures": t[when],
            }
            for when, key in keys.items()
        ]
    if not found:  # nothing was tuned
        first = next(m for m in models if m["number"] == ranking[0])
        start = first["starts"][first["best_start"]]
        found = [
            {
                "number": first["number"],
                "name": first["name"],
                "tuned": False,
                "weights_key": start["weights_key"],
                "figures": start,
            }
        ]

    def order(model: Mapping[str, Any]) -> tuple[bool, float]:
        figures = model["figures"]
        return not figures.get("forgets", True), _or_inf(figures["validation_score"])

    return min(found, key=order)


def _digest(data: Prepared, settings: Settings) -> str:
    """Return the hash of the data that a job uses."""
    digest = hashlib.sha256(f"{VERSION} {settings.input_lag_start}".encode())
    for array in (data.samples.u, data.samples.y, data.samples.weight, data.role, data.enabled):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr([(s.start, s.stop) for s in data.segments]).encode())
    digest.update(repr(data.scaling).encode())
    return digest.hexdigest()


def _key(kind: str, digest: str, job: Job) -> str:
    settings = (job.candidate.training, job.seed, job.iterations)
    tail = hashlib.sha256(f"{digest} {settings}".encode()).hexdigest()[:16]
    return f"{kind}_{tail}"


def _or_inf(value: float | None) -> float:
    return np.inf if value is None else value
