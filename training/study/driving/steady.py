"""A model trained at steady operating points, used on transient driving.

*Model Based Diagnosis of Oxygen Sensors* trains at steady points and predicts drive cycles. Here
the paper's structure is trained twice, by the same recipe and on equally many samples: once on
steady driving and once on all driving. Both models run freely on the same transient drives.
"""

from typing import Any

from monitor.base.errors import RecordingError
from training.jobs.json_tree import json_tree
from training.recordings.samples.preparation import Prepared, Role, prepare
from training.study.free_runs import FreeRun, judged_on
from training.study.narx.models import Recipe, thin, trained
from training.study.task import LAGS, Parts, Task, source

HIDDEN = (8, 8)  # of the paper
FEWEST = 1500  # least training samples for a network of 400 weights
STARTS = 3  # at most
BUDGET_SHARE = 0.1  # of the study's budget, for one of six trainings


def steady_against_mixed(task: Task, _: Parts) -> dict[str, Any]:
    """Return free-run errors on transient drives, after steady and after mixed training.

    Raises RecordingError if there are too few steady samples; the study then leaves this part out.
    """
    if not task.steady:
        raise RecordingError("no recordings at steady operating points (--steady)")
    if not task.test and {r.sha256 for r in task.steady} & {r.sha256 for r in task.recordings}:
        raise RecordingError("steady recordings train both models: give drives to judge (--test)")
    settings = task.settings
    steady = prepare(task.steady, task.inputs, task.output, lags=LAGS, seed=settings.seed)
    whole = (steady, task.data)
    counts = [int((d.role == Role.TRAIN).sum()) for d in whole]
    n = min(*counts, settings.n_samples)
    if n < FEWEST:
        raise RecordingError(
            f"{counts[0]} training samples of steady operation, {counts[1]} of all driving, "
            f"{settings.n_samples} by --samples: {FEWEST} of each are wanted"
        )
    few = [thin(data, n) for data in whole]
    minutes = BUDGET_SHARE * settings.budget_minutes
    recipe = Recipe(LAGS, HIDDEN, min(STARTS, settings.starts), settings.seed, minutes)
    models = {}
    every = zip(("steady", "mixed"), few, trained(few, recipe, task.jobs), strict=True)
    for name, data, starts in every:
        best = min(starts, key=lambda t: t.score)
        run = FreeRun.of(judged_on(task, data), best.spec, best.weights)
        models[name] = run.errors() | {
            "own_validation_rmse": best.score * data.scaling.y_std,
            "samples": int((data.role == Role.TRAIN).sum()),
            "source": source(task.steady if name == "steady" else task.recordings),
            "cut": best.cut_short,
            "outside": _outside(data, run),
        }
    return json_tree(
        {
            "models": models,
            "test": "held-out recordings" if task.test else "test blocks of the recordings",
            "test_source": source(task.test or task.recordings),
        }
    )


def _outside(data: Prepared, run: FreeRun) -> float:
    """Return the share of test samples with an input at or outside the trained range."""
    s = data.scaling
    low, high = ((edge - s.u_mean) / s.u_std for edge in (s.u_low, s.u_high))
    u = run.data.samples.u[run.rows]
    return float(((u <= low + 1e-9) | (u >= high - 1e-9)).any(axis=1).mean())
