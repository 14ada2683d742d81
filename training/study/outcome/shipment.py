"""The study's model file: limits and preparation in its card, and a test of its bound."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base import config
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from training.jobs.json_tree import plain
from training.limits.decision_limits import MANY_WINDOWS, set_limits
from training.narx.export import update_card
from training.narx.model_file import held_out, write_model
from training.narx.network import Spec, simulate
from training.narx.stability import CONTRACTION_SAMPLES, contraction
from training.narx.stages import free_run
from training.recordings.preparation import Prepared
from training.study.outcome.choice import BOUNDED_RUNS, BOUNDED_SAMPLES, Contender
from training.study.task import Task, as_in_use


def ship(
    task: Task, chosen: Contender, linear_preparation: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Write ``model.onnx`` with limits and the study's preparation in its card; return figures."""
    data, path = task.data, task.out / "model.onnx"
    gap = contraction(data, chosen.spec, chosen.weights, task.settings.seed)
    predicted = data.scaling.unscale_y(free_run(data, chosen.spec, chosen.weights))
    temporary = task.folder / "model.onnx"
    _, card = write_model(
        temporary, data, spec=chosen.spec, weights=chosen.weights, predicted=predicted, gap=gap
    )
    if linear_preparation is not None:
        card = replace(card, checks={**card.checks, "study_preparation": dict(linear_preparation)})
        update_card(temporary, card)
    warnings = []
    if not gap.gap <= gap.limit:
        warnings.append(
            "the model does not forget a wrong start: two runs that begin with different past "
            f"values differ by {gap.gap:.3g} after {CONTRACTION_SAMPLES} samples "
            f"(limit {gap.limit:.3g})"
        )
    card, more = _limits(task, temporary, card)
    temporary.replace(path)
    return plain(
        {
            "path": path.name,
            "warnings": warnings + more,
            "limits": {
                k: {"value": v.value, "unit": v.unit, "origin": v.origin}
                for k, v in card.limits.items()
            },
            "parity": card.checks["parity"],
            "bounded": bounded(data, chosen.spec, chosen.weights, task.settings.seed),
        }
    )


def _limits(task: Task, path: Path, card: ModelCard) -> tuple[ModelCard, list[str]]:
    try:
        card, windows = set_limits(path, task.recordings, held_out(task.data), config.load())
    except RecordingError as error:
        return card, [f"the model has no decision limits: {error}"]
    if windows < MANY_WINDOWS:
        text = f"the decision limits rest on {windows} windows, {MANY_WINDOWS} are wanted"
        return card, [text]
    return card, []


def bounded(data: Prepared, spec: Spec, weights: FloatArray, seed: int) -> dict[str, Any]:
    """Return the number of stuck free runs from random histories, and the largest error.

    Feedback is clipped to the output's range, so a free run cannot leave the range. A run is stuck
    if it stays at an end of the range while the measurement is elsewhere. Errors are in scaled
    units.
    """
    rng = np.random.default_rng(seed)
    longest = max(data.segments, key=lambda s: s.stop - s.start)
    length = min(BOUNDED_SAMPLES, (longest.stop - longest.start - spec.memory) // 2)
    u = as_in_use(data).samples.u
    ends, worst = 0, 0.0
    for _ in range(BOUNDED_RUNS):
        start = int(rng.integers(longest.start + spec.memory, longest.stop - length + 1))
        history = rng.uniform(spec.y_min, spec.y_max, (1, spec.lags))
        at, stop = np.array([start]), np.array([start + length])
        part = u[start - spec.memory : start + length]
        run = simulate(
            spec,
            weights,
            u=part,
            start=at - start + spec.memory,
            stop=stop - start + spec.memory,
            history=history,
        )[spec.memory :]
        y = data.samples.y[start : start + length]
        worst = max(worst, float(np.abs(run[length // 2 :] - y[length // 2 :]).max()))
        tail, own = run[length // 2 :], y[length // 2 :]
        at_end = (tail <= spec.y_min) | (tail >= spec.y_max)
        stuck = at_end & (np.abs(tail - own) > 0.1 * (spec.y_max - spec.y_min))
        ends += int(stuck.mean() > 0.5)
    return {"runs": BOUNDED_RUNS, "samples": length, "stuck": ends, "largest_error": worst}
