"""Parts 5 and 6 of the study: the gain of closed-loop training, and the choice of the model.

Candidates are the tuned models of the NARX study and the free structure, a model whose memory and
size are chosen by the data. Only the free-run error on the validation blocks decides; test blocks
and held-out recordings are only reported.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from training.jobs.json_tree import plain
from training.narx.fit import FitResult, fit
from training.narx.model_file import measures
from training.narx.network import Spec, describe
from training.narx.stability import contraction
from training.narx.stages import blocks_of, free_run, train
from training.narx.starts import committee
from training.recordings.preparation import Prepared, Role
from training.study.narx import parallel
from training.study.narx.models import from_arrays
from training.study.task import Settings, Task, judged_on

LEAST_GAIN = 0.01  # of the RMSE; a smaller gain does not justify more weights
FEW_BLOCKS, FEW_GAIN = 3, 0.1  # with fewer blocks chance cannot be estimated; FEW_GAIN applies
SURE = 1.0  # models closer than so many standard errors over the blocks are equal
BOUNDED_RUNS, BOUNDED_SAMPLES = 200, 1000


@dataclass(frozen=True, slots=True)
class Contender:
    """One candidate of the choice."""

    name: str
    spec: Spec
    weights: FloatArray
    before: FloatArray | None  # weights before closed-loop training
    number: int | None = None  # number among the 29 models
    stage: str = ""  # stage of closed-loop training with the kept weights


def free_structure(task: Task) -> dict[str, Any]:
    """Return the model of ``fit``, which chooses memory and size by the data, and all tries.

    Raises RecordingError or UsageError if the recordings cannot be used.
    """
    path = task.folder / "free.onnx"
    settings = task.settings
    starts = None if settings.starts == Settings().starts else settings.starts
    result = fit(
        task.recordings,
        task.inputs,
        task.output,
        path,
        starts=starts,
        budget_minutes=settings.budget_minutes,
        seed=settings.seed,
        threads=task.jobs,
        keep_validation=True,  # the blocks compare this model with the 29 others
    )
    return _free_dict(task, result)


def _free_dict(task: Task, result: FitResult) -> dict[str, Any]:
    spec, members = result.network.spec, result.starts[result.best].members
    one = replace(spec, hidden=tuple(n // members for n in spec.hidden))  # one committee member
    same = [t for t in result.starts if t.spec == one and t.members == 1]
    best = min(same, key=lambda t: t.score)
    seed = task.settings.seed + 1000 * same.index(best)  # gives the same initial weights
    limit = 60.0 * max(task.settings.budget_minutes, 0.1) / 5
    one_step = train(task.data, one, seed, time.monotonic() + limit, horizons=())
    tries = sorted(result.tries, key=lambda t: t.rmse)
    tables = {
        "structure": describe(spec),
        "members": members,
        "n_weights": spec.n_weights,
        "seconds": result.seconds,
        "warnings": list(result.warnings),
        "stage": _best_stage(best.stages),
        "starts": [t.score for t in result.starts],
        "tries": [{**asdict(t.structure), "n_weights": t.n_weights, "rmse": t.rmse} for t in tries],
    }
    widened = committee(one, members * [one_step.weights])[1]  # the same network, at full width
    first = widened.tolist() if one_step.stages else None
    weights = {
        "spec": asdict(spec),
        "weights": result.network.weights.tolist(),
        "one_step_weights": first,
    }
    return plain(tables) | weights


def _best_stage(stages: Sequence[Any]) -> str:
    return min(stages, key=lambda s: min(s.scores)).name if stages else "none"


def contenders(task: Task, narx: Mapping[str, Any], free: Mapping[str, Any]) -> list[Contender]:
    """Return the tuned models of the NARX study and the free structure, with their weights.

    Raises UsageError if no model could be trained.
    """
    found = []
    folder = task.folder / "narx"
    for t in narx.get("tuned", []):
        model = next(m for m in narx["models"] if m["number"] == t["number"])
        before = from_arrays(
            parallel.arrays_of(folder, model["starts"][t["start"]]["weights_key"])
        )[1]
        spec, weights = from_arrays(parallel.arrays_of(folder, t["weights_key"]))
        stage = _stage_of(t)
        found.append(
            Contender(
                name=t["name"],
                spec=spec,
                weights=weights,
                before=before,
                number=t["number"],
                stage=stage,
            )
        )
    if "spec" in free:
        spec = spec_from(free["spec"])
        found.append(
            Contender(
                name="free structure",
                spec=spec,
                weights=np.array(free["weights"]),
                before=_array(free["one_step_weights"]),
                stage=free["stage"],
            )
        )
    if not found:
        reasons = [part["skipped"] for part in (narx, free) if "skipped" in part]
        raise UsageError(f"no model could be trained: {'; '.join(dict.fromkeys(reasons))}")
    return found


def _array(values: Sequence[float] | None) -> FloatArray | None:
    return None if values is None else np.array(values)


def _stage_of(tuned: Mapping[str, Any]) -> str:
    if tuned["after"]["validation_score"] == tuned["before"]["validation_score"]:
        return "none"
    scores = [
        (s["best_score"], i) for i, s in enumerate(tuned["stages"]) if s["best_score"] is not None
    ]
    return str(tuned["stages"][min(scores)[1]]["name"]) if scores else "none"


def spec_from(stored: Mapping[str, Any]) -> Spec:
    """Return the network shape from its stored form, ``asdict`` written as JSON."""
    boxes = tuple((int(a), int(b)) for a, b in stored["input_boxes"])
    return Spec(**{**stored, "hidden": tuple(stored["hidden"]), "input_boxes": boxes})


def choose(task: Task, models: Sequence[Contender]) -> dict[str, Any]:
    """Return the figures of all candidates, the chosen one and the reason.

    Two models are equal if their free-run errors on the validation blocks differ by less than a
    standard error over the blocks or by less than 1 %. Of the models equal to the best the smallest
    is chosen. For lambda, models that do not forget their history come last.
    Raises RecordingError if every model diverges.
    """
    data = task.data
    memory = max(m.spec.memory for m in models)
    held = judged_on(task)
    rows, squares, total = [], [], 1.0
    for m in models:
        blocks = blocks_of(data, m.spec, Role.VALIDATE, memory)
        squares.append(blocks.squares(m.weights))
        total = blocks.total_weight
        gap = contraction(data, m.spec, m.weights, task.settings.seed)
        rows.append(
            {
                "name": m.name,
                "number": m.number,
                "structure": describe(m.spec),
                "n_weights": m.spec.n_weights,
                "stage": m.stage,
                "validation_rmse": float(np.sqrt(squares[-1].sum() / total)),
                "forgets": bool(gap.gap <= gap.limit),
                "gap": gap.gap,
                "gap_limit": gap.limit,
                **_before_after(data, held, m),
            }
        )
    chosen, equal, reason = _decide(rows, squares, strict=data.transform == "phi")
    test = "held-out recordings" if task.test else "test blocks"
    result = {
        "candidates": rows,
        "chosen": chosen,
        "equal": equal,
        "reason": reason,
        "test": test,
        "unit": data.output.unit,
    }
    return plain(result)


def _before_after(data: Prepared, held: Prepared, model: Contender) -> dict[str, Any]:
    """Return free-run errors on held-out samples, after and before closed-loop training."""
    found = {}
    for name, weights in (("after", model.weights), ("before", model.before)):
        if weights is not None:
            run = held.scaling.unscale_y(free_run(held, model.spec, weights))
            test = held.role == Role.TEST
            found[name] = {
                "all": measures(held, run, test),
                "enabled": measures(held, run, test & held.enabled),
            }
    return found


def _decide(
    rows: Sequence[Mapping[str, Any]], squares: Sequence[FloatArray], *, strict: bool
) -> tuple[int, list[int], str]:
    """Return the chosen row, the rows equal to the best, and the reason in words.

    squares : per row the squared errors summed per validation block
    strict : models that do not forget their history come last
    """
    finite = [i for i, r in enumerate(rows) if np.isfinite(r["validation_rmse"])]
    if not finite:
        raise RecordingError("every training diverged: no model predicts in free run")
    forgets = [i for i in finite if rows[i]["forgets"]]
    eligible = forgets if strict and forgets else finite
    best = min(eligible, key=lambda i: rows[i]["validation_rmse"])
    equal = []
    for i in eligible:
        loss = squares[i] - squares[best]
        error = float(loss.std(ddof=1)) * np.sqrt(len(loss)) if len(loss) > 1 else 0.0
        gain = LEAST_GAIN if len(loss) >= FEW_BLOCKS else FEW_GAIN
        close = rows[i]["validation_rmse"] < (1 + gain) * rows[best]["validation_rmse"]
        if i == best or close or float(loss.sum()) < SURE * error:
            equal.append(i)
    chosen = min(equal, key=lambda i: (rows[i]["n_weights"], rows[i]["validation_rmse"]))
    return chosen, equal, _reason(rows, chosen, best, equal, eligible, strict=strict)


def _reason(
    rows: Sequence[Mapping[str, Any]],
    chosen: int,
    best: int,
    equal: Sequence[int],
    eligible: Sequence[int],
    *,
    strict: bool,
) -> str:
    own, first = rows[chosen], rows[best]
    text = (
        f"Chosen: {own['name']} ({own['structure']}, {own['n_weights']} weights), free-run RMSE "
        f"{own['validation_rmse']:.4f} on the validation blocks (scaled)."
    )
    if chosen == best:
        text += " It is the best of all."
        if len(equal) > 1:
            text += f" {len(equal) - 1} larger ones are not told apart from it."
    else:
        text += (
            f" {first['name']} reaches {first['validation_rmse']:.4f} with {first['n_weights']} "
            "weights; over the blocks the two are not told apart, so the smaller one is chosen."
        )
    lost = len(rows) - len(eligible)
    if strict and lost:
        text += f" {lost} of {len(rows)} do not forget their history and come last."
    elif strict and not own["forgets"]:
        text += " No candidate forgets its history within a window: see the warning."
    return text
