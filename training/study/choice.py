"""The gain of closed-loop training, the choice of the model, and its file.

Candidates are the tuned models of the NARX study and the free structure, a model whose memory and
size are chosen by the data. Only the free-run error on the validation blocks decides; test blocks
and held-out recordings are only reported.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from monitor.base import config
from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from training.jobs.json_tree import json_tree
from training.limits.decision_limits import with_limits
from training.narx.cross_fit import cross_fit
from training.narx.export import update_card
from training.narx.fit import FitOptions, FitSource, fit, write_model
from training.narx.model_file import OF_TWINS
from training.narx.network import Spec, describe
from training.narx.search.mean import mean_of
from training.narx.search.stability import contraction
from training.narx.search.stages import Trained, blocks_of, train
from training.narx.work import Work
from training.recordings.samples.preparation import Role
from training.study.free_runs import FreeRun, judged_on
from training.study.narx.models import best_stage, spec_from
from training.study.task import Parts, Settings, Task

LEAST_GAIN = 0.01  # of the RMSE; a smaller gain does not justify more weights
FEW_BLOCKS, FEW_GAIN = 3, 0.1  # with fewer blocks chance cannot be estimated; FEW_GAIN applies
SURE = 1.0  # models closer than so many standard errors over the blocks are equal


@dataclass(frozen=True, slots=True)
class Contender:
    """One candidate of the choice."""

    name: str
    spec: Spec
    weights: FloatArray
    before: FloatArray | None  # weights before closed-loop training
    number: int | None = None  # number among the 29 models
    stage: str = ""  # stage of closed-loop training with the kept weights


def free_structure(task: Task, _: Parts) -> dict[str, Any]:
    """Return the model of ``fit``, which chooses memory and size by the data, and all tries.

    Raises RecordingError or UsageError if the recordings cannot be used.
    """
    settings = task.settings
    options = FitOptions(
        starts=None if settings.starts == Settings().starts else settings.starts,
        budget_minutes=settings.budget_minutes,
        seed=settings.seed,
        threads=task.jobs,
        keep_held_out=True,  # the blocks compare this model with the 29 others
    )
    source = FitSource(task.recordings, task.inputs, task.output)
    result = fit(source, task.folder / "free.onnx", options)
    spec, members = result.chosen.model.spec, result.chosen.members
    minutes = max(task.settings.budget_minutes, 0.1) / 5
    alone = [  # the same initial weights, one step ahead only
        train(task.data, Trained(t.spec, decay=t.decay, seed=t.seed), Work.of_minutes(minutes), ())
        for t in members
    ]
    one_step = mean_of([(t.spec, t.weights) for t in alone])[1]
    tables = {
        "structure": describe(spec),
        "members": len(members),
        "n_weights": spec.n_weights,
        "warnings": result.warnings,
        "stage": best_stage(result.chosen.best_member),
        "tries": [
            asdict(t.structure) | {"n_weights": t.n_weights, "rmse": t.rmse} for t in result.tries
        ],
    }
    return json_tree(tables) | {
        "spec": asdict(spec),
        "weights": result.chosen.model.weights.tolist(),
        "one_step_weights": one_step.tolist() if all(t.stages for t in alone) else None,
    }


def contenders(task: Task, parts: Parts) -> list[Contender]:
    """Return the tuned models of the NARX study and the free structure, with their weights.

    Raises UsageError if no model could be trained.
    """
    narx, free, found = parts["narx"], parts["free"], []
    for t in narx.get("tuned", []):
        keys = (t["weights_key"], t["weights_key"].replace("tune", "train"))
        files = [json.loads((task.folder / "narx" / f"{key}.json").read_text()) for key in keys]
        weights, before = (np.array(file["network"]["weights"]) for file in files)
        spec = spec_from(files[0]["network"]["spec"])
        found.append(Contender(t["name"], spec, weights, before, t["number"], t["stage"]))
    if "spec" in free:
        spec, first = spec_from(free["spec"]), free["one_step_weights"]
        weights, begun = np.array(free["weights"]), None if first is None else np.array(first)
        found.append(Contender("free structure", spec, weights, begun, stage=free["stage"]))
    if not found:
        reasons = [part["skipped"] for part in (narx, free) if "skipped" in part]
        raise UsageError(f"no model could be trained: {'; '.join(dict.fromkeys(reasons))}")
    return found


def chosen(task: Task, parts: Parts) -> Contender:
    """Return the model of the choice."""
    return contenders(task, parts)[parts["choice"]["chosen"]]


def choice(task: Task, parts: Parts) -> dict[str, Any]:
    """Return the figures of all candidates, the chosen one and the reason.

    Two models are equal if their free-run errors on the validation blocks differ by less than a
    standard error over the blocks or by less than 1 %. Of the models equal to the best the smallest
    is chosen. For lambda, models that do not forget their history come last.
    Raises RecordingError if every model diverges.
    """
    data, models = task.data, contenders(task, parts)
    memory = max(m.spec.memory for m in models)
    held = judged_on(task, task.data)
    rows, squares = [], []
    for m in models:
        blocks = blocks_of(data, m.spec, Role.VALIDATE, memory)
        squares.append(blocks.squares(m.weights))
        gap = contraction(data, m.spec, m.weights, task.settings.seed)
        weights = {"after": m.weights, "before": m.before}
        rows.append(
            {
                "name": m.name,
                "number": m.number,
                "structure": describe(m.spec),
                "n_weights": m.spec.n_weights,
                "stage": m.stage,
                "validation_rmse": float(np.sqrt(squares[-1].sum() / blocks.total_weight)),
                "forgets": gap.forgets,
                "gap": gap.gap,
                "gap_limit": gap.limit,
            }
            | {k: FreeRun.of(held, m.spec, w).errors() for k, w in weights.items() if w is not None}
        )
    best, equal, reason = decide(rows, squares, strict=data.transform == "phi")
    return json_tree(
        {
            "candidates": rows,
            "chosen": best,
            "equal": equal,
            "reason": reason,
            "test": "held-out recordings" if task.test else "test blocks",
            "output": task.output,
        }
    )


def decide(
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
    smallest = min(equal, key=lambda i: (rows[i]["n_weights"], rows[i]["validation_rmse"]))
    own, first = rows[smallest], rows[best]
    text = (
        f"Chosen: {own['name']} ({own['structure']}, {own['n_weights']} weights), free-run RMSE "
        f"{own['validation_rmse']:.4f} on the validation blocks (scaled)."
    )
    if smallest != best:
        text += (
            f" {first['name']} reaches {first['validation_rmse']:.4f} with {first['n_weights']} "
            "weights; over the blocks the two are not told apart, so the smaller one is chosen."
        )
    if strict and len(forgets) < len(rows):
        last = " and come last" if forgets else ""
        text += f" {len(rows) - len(forgets)} of {len(rows)} do not forget their history{last}."
    return smallest, equal, text


def ship(task: Task, parts: Parts) -> dict[str, Any]:
    """Write ``model.onnx`` with decision limits in its card; return them."""
    data, model, path = task.data, chosen(task, parts), task.folder / "model.onnx"
    gap = contraction(data, model.spec, model.weights, task.settings.seed)
    work = Work.of_minutes(task.settings.budget_minutes)
    twins = cross_fit(data, model.spec, seed=task.settings.seed, work=work, threads=task.jobs)
    card = write_model(path, model.spec, model.weights, twins, gap)
    warnings = gap.warnings()
    try:
        card = with_limits(card, list(twins.unseen(card)), OF_TWINS, config.load())
        update_card(path, card)
    except RecordingError as error:
        warnings.append(f"the model has no decision limits: {error}")
    path.replace(task.out / "model.onnx")
    spread = np.nanstd(np.concatenate([r.column(card.output.name) for r in task.recordings]))
    return json_tree(
        {
            "path": "model.onnx",
            "warnings": warnings,
            "limits": {
                k: {"value": v.value, "z": v.value / spread, "unit": v.unit, "origin": v.origin}
                for k, v in card.limits.items()
            },
        }
    )
