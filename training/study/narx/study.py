"""NARX study: 29 models from several starts; the best models are tuned in closed loop.

Validation blocks decide every choice; test blocks are only reported. A killed study resumes from
the jobs stored in its directory.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from training.recordings.samples.preparation import Prepared, Role
from training.study.narx.candidates import BAYES, CANDIDATES, LM, ModelCandidate, same_as
from training.study.narx.models import SEED_STEP, Job, spec_of, thin, train_one, tune_one
from training.study.narx.verdicts import judge, warnings
from training.study.results import fan_out, public
from training.study.task import Parts, Settings, Task, source

VERSION = 5  # of the jobs; stored jobs of another version are not reused

Model = dict[str, Any]


def narx_study(task: Task, _: Parts) -> dict[str, Any]:
    """Return the figures of all models and starts, and of the best models after tuning."""
    where = {"jobs": task.jobs, "scheduler": task.scheduler}
    wanted = task.settings.models
    models = [c for c in CANDIDATES if c.number in wanted or not wanted]
    return compared(task.data, task.folder / "narx", task.settings, models, **where)


def compared(
    data: Prepared,
    folder: Path,
    settings: Settings,
    candidates: Sequence[ModelCandidate],
    **where: Any,
) -> dict[str, Any]:
    """Return the figures of all candidates and starts, and of the best ones after tuning.

    folder : of the finished jobs
    where : ``jobs`` and ``scheduler`` as of ``fan_out``
    Raises RecordingError if the samples are too few.
    """
    thinned = thin(data, settings.n_samples)
    trainings = _trainings(thinned, settings, candidates)
    done = fan_out(train_one, thinned, trainings, folder, label="models", **where)
    models = [_model(thinned, c, candidates, trainings, done) for c in candidates]
    for model, labels in zip(models, judge(models), strict=True):
        model["verdict"] = labels
    once = sorted((m for m in models if m["same_as"] is None), key=lambda m: _score(_best_start(m)))
    tunings = {}
    for model in once[: settings.tune_best]:
        key = _best_start(model)["weights_key"]
        weights = tuple(done[key]["network"]["weights"])
        tunings[key.replace("train", "tune")] = replace(trainings[key], weights=weights)
    found = fan_out(tune_one, thinned, tunings, folder, label="closed loop", **where)
    tuned = [
        {"number": job.candidate.number, "name": job.candidate.name, "weights_key": key}
        | public(found[key])
        for key, job in tunings.items()
    ]
    return {
        "source": source(data.recordings),
        "inputs": list(data.names),
        "output": data.output.name,
        "period_s": data.period_ns / 1e9,
        "samples": {
            "training": int((thinned.role == Role.TRAIN).sum()),
            "training_available": int((data.role == Role.TRAIN).sum()),
            "validation": int((data.role == Role.VALIDATE).sum()),
            "test": int((data.role == Role.TEST).sum()),
            "enabled_share": round(float(thinned.enabled.mean()), 4),
        },
        "settings": asdict(settings),
        "models": models,
        "ranking": [m["number"] for m in once],
        "tuned": tuned,
        "warnings": warnings(data, thinned, models),
    }


def _trainings(
    data: Prepared, settings: Settings, candidates: Sequence[ModelCandidate]
) -> dict[str, Job]:
    """Return the jobs by key, the longest first; equal models share their jobs."""
    weights = {c: spec_of(data, c).n_weights for c in candidates}
    n, least = data.n_train, min(weights.values())
    if n < least:
        raise RecordingError(
            f"{n} training samples for {least} weights of the smallest model are too few"
        )
    digest, result = _digest(data), {}
    efforts = {c: weights[c] ** (1 + (c.algorithm in (LM, BAYES))) for c in candidates}
    for c in sorted(efforts, key=efforts.__getitem__, reverse=True):
        for start in range(settings.starts if c.number not in same_as(candidates) else 0):
            job = Job(c, settings.seed + SEED_STEP * start, settings.iterations)
            text = f"{digest} {(c.training, job.seed, job.iterations)}"
            result[f"train_{hashlib.sha256(text.encode()).hexdigest()[:16]}"] = job
    return result


def _model(
    data: Prepared,
    candidate: ModelCandidate,
    candidates: Sequence[ModelCandidate],
    trainings: Mapping[str, Job],
    done: Mapping[str, Model],
) -> Model:
    keys = [k for k, j in trainings.items() if j.candidate.training == candidate.training]
    starts = [public(done[k]) | {"weights_key": k} for k in keys]
    return asdict(candidate) | {
        "name": candidate.name,
        "same_as": same_as(candidates).get(candidate.number),
        "n_weights": spec_of(data, candidate).n_weights,
        "starts": starts,
        "best_start": min(range(len(starts)), key=lambda i: _score(starts[i])),
    }


def _score(figures: Model) -> float:
    score = figures["validation_score"]
    return np.inf if score is None else float(score)


def _best_start(model: Model) -> Model:
    return dict(model["starts"][model["best_start"]])


def _digest(data: Prepared) -> str:
    """Return the hash of the data that a job uses."""
    digest = hashlib.sha256(f"{VERSION} {data.scaling}".encode())
    for array in (data.samples.u, data.samples.y, data.samples.weight, data.role, data.enabled):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr([(s.start, s.stop) for s in data.segments]).encode())
    return digest.hexdigest()
