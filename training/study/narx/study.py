"""NARX study: 29 models from several starts; the best models are tuned in closed loop.

Validation blocks decide every choice; test blocks are only reported. A killed study resumes from
the jobs stored in its directory.
"""

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from training.recordings.preparation import Prepared, Role
from training.study.narx.candidates import BAYES, CANDIDATES, LM, Candidate, same_as
from training.study.narx.models import (
    HORIZONS,
    SEED_STEP,
    Job,
    spec_of,
    thin,
    train_one,
    tune_one,
)
from training.study.narx.verdicts import findings, judge, rules, warnings
from training.study.results import fan_out, public, stored
from training.study.task import Parts, Settings, Task, source

VERSION = 2  # of the jobs; stored jobs of another version are not reused

SHOWN = ("starts", "iterations", "n_samples", "tune_best", "seed")  # settings in the result

Model = dict[str, Any]


def narx_study(task: Task, _: Parts) -> dict[str, Any]:
    """Return the figures of all models and starts, and of the best models after tuning."""
    return compared(
        task.data,
        task.folder / "narx",
        task.settings,
        task.models,
        jobs=task.jobs,
        scheduler=task.scheduler,
    )


def compared(
    data: Prepared,
    folder: Path,
    settings: Settings,
    candidates: Sequence[Candidate] = CANDIDATES,
    **where: Any,
) -> dict[str, Any]:
    """Return the figures of all candidates and starts, and of the best ones after tuning.

    folder : of the finished jobs
    where : ``jobs`` and ``scheduler`` as of ``fan_out``
    Raises RecordingError if the samples are too few, UsageError for impossible settings.
    """
    began = time.monotonic()
    if settings.starts < 1 or settings.iterations < 1 or not candidates:
        raise UsageError(
            f"{len(candidates)} models, {settings.starts} starts, {settings.iterations} "
            "iterations: at least one of each is wanted"
        )
    thinned = thin(data, settings.n_samples)
    trainings = _trainings(thinned, settings, candidates)
    done = fan_out(train_one, thinned, trainings, folder, label="models", **where)
    models = _models(thinned, candidates, trainings, done)
    for model, verdict in zip(models, judge(models, settings.iterations), strict=True):
        model["verdict"] = verdict
    once = [m for m in models if m["same_as"] is None]
    ranking = [m["number"] for m in sorted(once, key=lambda m: _score(_best_start(m)))]
    tunings = _tunings(models, ranking[: settings.tune_best], trainings, folder)
    found = fan_out(tune_one, thinned, tunings, folder, label="closed loop", **where)
    tuned = [
        {"number": job.candidate.number, "name": job.candidate.name}
        | public(found[key])
        | {"weights_key": key}
        for key, job in tunings.items()
    ]
    trainings_of = [*tuned, *(s for m in models for s in m["starts"])]
    cpu_s = {s["weights_key"]: s["cpu_s"] for s in trainings_of}
    counts = {role: int((data.role == role).sum()) for role in Role}
    result = {
        "source": source(data.recordings),
        "inputs": [c.name for c in data.inputs],
        "output": data.output.name,
        "period_s": data.period_ns / 1e9,
        "samples": {
            "training": int((thinned.role == Role.TRAIN).sum()),
            "training_available": counts[Role.TRAIN],
            "validation": counts[Role.VALIDATE],
            "test": counts[Role.TEST],
            "enabled_share": round(float(thinned.enabled.mean()), 4),
        },
        "settings": {name: getattr(settings, name) for name in SHOWN}
        | {"horizons": list(HORIZONS), "input_lag_start": 1},
        "models": models,
        "ranking": ranking,
        "tuned": tuned,
        "best": _best(models, tuned),
        "rules": rules(settings.iterations),
        "cpu_s": round(sum(cpu_s.values()), 1),
        "warnings": warnings(data, thinned, models),
    }
    seconds = round(time.monotonic() - began, 1)
    return result | {"findings": findings(result), "seconds": seconds}


def _trainings(
    data: Prepared, settings: Settings, candidates: Sequence[Candidate]
) -> dict[str, Job]:
    """Return the jobs by key, the longest first; equal models share their jobs."""
    weights = {c: spec_of(data, c).n_weights for c in candidates}
    n, smallest = _samples(data), min(weights.values())
    if n < smallest:
        raise RecordingError(
            f"{n} training samples for {smallest} weights of the smallest model are too few"
        )
    digest = _digest(data)
    same = same_as(candidates)
    result = {}
    for c in sorted(
        candidates, key=lambda c: weights[c] ** (1 + (c.algorithm in (LM, BAYES))), reverse=True
    ):
        for start in range(settings.starts if c.number not in same else 0):
            job = Job(c, start, settings.seed + SEED_STEP * start, settings.iterations)
            text = f"{digest} {(c.training, job.seed, job.iterations)}"
            result[f"train_{hashlib.sha256(text.encode()).hexdigest()[:16]}"] = job
    return result


def _samples(data: Prepared) -> int:
    return int(((data.role == Role.TRAIN) & (data.samples.weight > 0)).sum())


def _models(
    data: Prepared,
    candidates: Sequence[Candidate],
    trainings: Mapping[str, Job],
    done: Mapping[str, Model],
) -> list[Model]:
    models = []
    for c in candidates:
        keys = [k for k, j in trainings.items() if j.candidate.training == c.training]
        starts = [public(done[k]) | {"weights_key": k} for k in keys]
        own = {
            "hidden": list(c.hidden),
            "name": c.name,
            "same_as": same_as(candidates).get(c.number),
            "n_weights": spec_of(data, c).n_weights,
            "starts": starts,
            "best_start": min(range(len(starts)), key=lambda i: _score(starts[i])),
        }
        models.append(asdict(c) | own)
    return models


def _score(figures: Mapping[str, Any]) -> float:
    score = figures["validation_score"]
    return np.inf if score is None else float(score)


def _best_start(model: Model) -> Model:
    return dict(model["starts"][model["best_start"]])


def _tunings(
    models: Sequence[Model], numbers: Sequence[int], trainings: Mapping[str, Job], folder: Path
) -> dict[str, Job]:
    """Return the jobs that tune the best start of every one of the best models, by key."""
    by_number = {m["number"]: m for m in models}
    result = {}
    for number in numbers:
        key = _best_start(by_number[number])["weights_key"]
        begun = stored(folder / f"{key}.json") or {}
        job = replace(trainings[key], weights=tuple(begun["network"]["weights"]))
        result[key.replace("train", "tune")] = job
    return result


def _best(models: Sequence[Model], tuned: Sequence[Model]) -> dict[str, Any]:
    """Return the best model, before or after tuning.

    Models that forget their history come first; among them the free-run validation error decides.
    """
    found = []
    for t in tuned:
        model = next(m for m in models if m["number"] == t["number"])
        keys = {"before": model["starts"][t["start"]]["weights_key"], "after": t["weights_key"]}
        found += [
            {"number": t["number"], "name": t["name"], "tuned": when == "after"}
            | {"weights_key": key, "figures": t[when]}
            for when, key in keys.items()
        ]
    return min(
        found,
        key=lambda m: (not m["figures"].get("forgets", True), _score(m["figures"])),
    )


def _digest(data: Prepared) -> str:
    """Return the hash of the data that a job uses."""
    digest = hashlib.sha256(f"{VERSION}".encode())
    for array in (data.samples.u, data.samples.y, data.samples.weight, data.role, data.enabled):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr([(s.start, s.stop) for s in data.segments]).encode())
    digest.update(repr(data.scaling).encode())
    return digest.hexdigest()
