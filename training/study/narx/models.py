"""One model of the NARX study: series-parallel training, closed-loop tuning, figures.

Training and tuning are pure functions of data and settings, so that any machine can run them.
Figures are in scaled units (zero mean, unit variance over the training samples); one-step and
free-run figures use the same samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from monitor.base.runs import runs
from monitor.base.types import FloatArray, IntArray
from training.jobs.json_tree import json_tree
from training.narx.algorithms import lm
from training.narx.algorithms.objectives import one_step
from training.narx.network import Spec, forward, initial_weights, regressors
from training.narx.search import stages
from training.narx.work import Work
from training.recordings.metrics import correlation
from training.recordings.samples.preparation import Prepared, Role, Samples
from training.study.narx import first_order
from training.study.narx.bayes import minimise_bayesian
from training.study.narx.candidates import BAYES, CONJUGATE, LM, ModelCandidate

BLOCK = 1000  # largest block, in samples, that thinning keeps or drops as a whole
ENOUGH = 50  # least enabled samples per role for figures on enabled samples
NOT_USED = -1  # role of training samples that thinning drops
STUCK_SHARE = 0.01  # a free run with more samples wrongly at an end of the range has diverged
SEED_STEP = 1000  # difference of the seeds of two starts, as in ``fit``


@dataclass(frozen=True, slots=True)
class Recipe:
    """Whole trainings of one shape: series-parallel from random weights, then in closed loop."""

    lags: int
    hidden: tuple[int, ...]
    starts: int
    seed: int
    budget_minutes: float  # of each start
    horizons: tuple[int, ...] = stages.HORIZONS  # samples


def trained(data: Sequence[Prepared], recipe: Recipe, jobs: int) -> list[list[stages.Trained]]:
    """Return the starts of the recipe on each of the data, ``jobs`` of them side by side."""
    seeds = range(recipe.seed, recipe.seed + SEED_STEP * recipe.starts, SEED_STEP)
    begun = [(d, stages.Trained(spec_of(d, recipe), seed=s)) for d, s in product(data, seeds)]

    def train(place: tuple[Prepared, stages.Trained], work: Work) -> stages.Trained:
        return stages.train(*place, work, recipe.horizons)

    whole = Work.of_minutes(recipe.budget_minutes * len(begun))
    found = whole.side_by_side(train, begun, jobs)
    return [found[i : i + len(seeds)] for i in range(0, len(found), len(seeds))]


@dataclass(frozen=True, slots=True)
class Job:
    """One training: series-parallel from random weights, or in closed loop from ``weights``."""

    candidate: ModelCandidate
    seed: int
    iterations: int
    weights: tuple[float, ...] = ()  # initial weights of a closed-loop tuning


def thin(data: Prepared, n_samples: int) -> Prepared:
    """Return ``data`` with at most ``n_samples`` training samples and without its recordings.

    Whole blocks are kept, evenly spread over all recordings; samples of other blocks get the role
    NOT_USED. If a role has fewer than ``ENOUGH`` enabled samples, all samples count as enabled.
    """
    role, length, blocks = data.role.copy(), int(np.clip(n_samples // 20, 20, BLOCK)), []
    for s in data.segments:
        for first, stop in runs(data.role[s.start : s.stop] == Role.TRAIN):
            edges = [*range(s.start + first, s.start + stop, length), s.start + stop]
            blocks += [slice(a, b) for a, b in pairwise(edges)]
    sizes = np.array([b.stop - b.start for b in blocks])
    share = n_samples / max(int(sizes.sum()), 1)
    if share < 1.0:
        role[role == Role.TRAIN] = NOT_USED
        kept = 0
        for block, size, seen in zip(blocks, sizes, np.cumsum(sizes), strict=True):
            if kept + size <= share * seen:
                role[block] = Role.TRAIN
                kept += size
    valid = data.samples.weight > 0
    judged = data.enabled & valid
    if min(int((judged & (role == r)).sum()) for r in Role) < ENOUGH:
        judged = valid
    return replace(data, role=role, enabled=judged, recordings=())


def spec_of(data: Prepared, shape: ModelCandidate | Recipe) -> Spec:
    """Return the shape for ``data``; feedback is clipped to the output's range."""
    return Spec(len(data.inputs), shape.lags, shape.hidden, 1, *data.scaling.y_scaled_limits)


def spec_from(stored: Mapping[str, Any]) -> Spec:
    """Return the network shape from its stored form, ``asdict`` written as JSON."""
    boxes = tuple((int(a), int(b)) for a, b in stored["input_boxes"])
    return Spec(**{**stored, "hidden": tuple(stored["hidden"]), "input_boxes": boxes})


def rows(data: Prepared, spec: Spec, role: Role | None = None) -> IntArray:
    """Return the indices of the scored samples of ``role`` whose lags lie in the same segment."""
    inside = np.zeros(len(data.role), dtype=bool)
    for segment in data.segments:
        inside[segment.start + spec.lags : segment.stop] = True
    inside &= data.samples.weight > 0
    return np.flatnonzero(inside if role is None else inside & (data.role == role))


def train_one(data: Prepared, job: Job) -> dict[str, Any]:
    """Return figures and weights of one start, trained series-parallel.

    The training stops early by the one-step validation error, except with Bayesian regularisation.
    """
    data, spec = _writable(data), spec_of(data, job.candidate)
    outcome = _minimise(data, spec, initial_weights(spec, np.random.default_rng(job.seed)), job)
    before = outcome.costs[-max(2, len(outcome.costs) // 10)]  # of the last tenth of iterations
    result = {
        "iterations": len(outcome.costs) - 1,
        "stop": outcome.stop,
        "unfinished": outcome.stop == "epochs" and outcome.costs[-1] < 0.99 * before,
        **figures(data, spec, outcome.weights),
    }
    network = {"spec": asdict(spec), "weights": outcome.weights.tolist()}
    return json_tree(result) | {"network": network}


def tune_one(data: Prepared, job: Job) -> dict[str, Any]:
    """Return stage and weights of a tuning in closed loop, over growing horizons."""
    data, spec = _writable(data), spec_of(data, job.candidate)
    before = np.array(job.weights)
    found = stages.train(data, stages.Trained(spec, before, seed=job.seed))
    gains = found.score < stages.blocks_of(data, spec).score(before)
    stage = best_stage(found) if gains else "none"
    network = {"spec": asdict(spec), "weights": found.weights.tolist()}
    return {"stage": stage, "network": network}


def best_stage(trained: stages.Trained) -> str:
    """Return the name of the stage with the lowest validation error."""
    return min(trained.stages, key=lambda s: min(s.scores)).name if trained.stages else "none"


def figures(data: Prepared, spec: Spec, weights: FloatArray) -> dict[str, Any]:
    """Return R and MSE per role, one-step and in free run, on enabled samples.

    Also returned: the free-run validation score, the share of stuck predictions, and whether the
    free run diverges.
    """
    at, y = rows(data, spec), data.samples.y
    one_step = np.full(len(y), np.nan)
    phi = regressors(spec, data.samples.u, data.samples.y)
    one_step[at] = forward(spec, weights, phi[at - spec.memory])
    free = stages.free_run(data, spec, weights)
    at_end = (free[at] <= spec.y_min) | (free[at] >= spec.y_max)
    # at an end of the range with a measurement farther away than a tenth of it
    stuck = np.mean(at_end & (np.abs(free[at] - y[at]) > 0.1 * (spec.y_max - spec.y_min)))
    held_out = at[np.isin(data.role[at], (Role.VALIDATE, Role.TEST)) & data.enabled[at]]
    worse = not np.mean((y[held_out] - free[held_out]) ** 2) < y[held_out].var()
    return {
        "one_step": _by_role(data, spec, one_step),
        "free_run": _by_role(data, spec, free),
        "validation_score": stages.blocks_of(data, spec).score(weights),
        "stuck_share": stuck,
        "diverged": bool(worse or stuck > STUCK_SHARE),
    }


def _minimise(data: Prepared, spec: Spec, weights: FloatArray, job: Job) -> lm.LmOutcome:
    """Return the outcome of the candidate's algorithm, with the reference toolbox's defaults."""
    algorithm, epochs = job.candidate.algorithm, job.iterations
    at, held = (rows(data, spec, role) for role in (Role.TRAIN, Role.VALIDATE))
    objective, validate = one_step(spec, data.samples, at), one_step(spec, data.samples, held).cost
    if algorithm == LM:
        return lm.minimise(objective, weights, validate, epochs=epochs)
    if algorithm == BAYES:
        return minimise_bayesian(objective, weights, len(at), epochs)[0]
    phi = regressors(spec, data.samples.u, data.samples.y)[at - spec.memory]
    target, weight = data.samples.y[at], data.samples.weight[at]
    by_torch = first_order.one_step_by_torch(spec, phi, target, weight)
    if algorithm == CONJUGATE:
        return first_order.minimise_scaled_conjugate(by_torch, weights, epochs, validate)
    rate = job.candidate.rate or first_order.RATE
    return first_order.descend(by_torch, weights, epochs, rate, validate)


def _by_role(data: Prepared, spec: Spec, predicted: FloatArray) -> dict[str, dict[str, Any]]:
    every = {role.name.lower(): rows(data, spec, role) for role in Role}
    return {
        k: {"enabled": _measure(data, predicted, at[data.enabled[at]])} for k, at in every.items()
    }


def _measure(data: Prepared, predicted: FloatArray, at: IntArray) -> dict[str, Any]:
    a, b = data.samples.y[at], predicted[at]
    if len(at) < 2 or not np.isfinite(b).all():
        return {"samples": len(at), "r": None, "mse": None}
    return {"samples": len(at), "r": correlation(a, b), "mse": float(np.mean((a - b) ** 2))}


def _writable(data: Prepared) -> Prepared:
    """Return ``data`` with copied arrays, because a cluster sends read-only arrays."""
    s = data.samples
    return replace(data, samples=Samples(*(np.array(a) for a in (s.u, s.y, s.weight))))
