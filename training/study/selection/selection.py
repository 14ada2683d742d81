"""Inputs of the model, their reasons, and the error of other input sets."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.files.manifest import source_of
from monitor.base.types import FloatArray
from training.limits.data_check.measures import variance_inflation
from training.recordings.recording import Recording
from training.recordings.samples.augmentation import CONTROLLER
from training.recordings.samples.linear_data import cleaned, output_transform
from training.recordings.samples.rows import runs
from training.study.selection.components import pca
from training.study.selection.input_sets import (
    NEGLIGIBLE,
    InputSet,
    Tried,
    aligned,
    correlations,
    difference,
    figures,
    scored_rows,
    try_sets,
)
from training.study.selection.transparency import transparency
from training.study.task import Parts, Task

REASONS = {
    "vehicle_speed_km_h": "engine speed and gear; its effect on the mixture goes through the "
    "engine's air, fuel and speed",
    "engine_speed_rpm": "sets delay and flow together with the air mass; MAF is their product",
    "engine_torque_nm": "computed by the ECU from air mass and speed: nothing of its own",
    "air_mass_mg": "numerator of the air-fuel ratio",
    "fuel_mass_mg": "denominator of the air-fuel ratio, with every correction the ECU makes",
    "manifold_temperature_degc": "density of the charge and evaporation of the fuel film",
    "manifold_pressure_kpa": "filling, and the pressure that purge and exhaust gas act against",
    "throttle_percent": "acts on the mixture through the manifold pressure, which is measured",
    "maf_kg_h": "exhaust flow: transport delay and mixing depend on it",
    "rail_pressure_mpa": "what the injectors deliver for a commanded fuel mass",
    CONTROLLER: "the correction in the mixture; but it is made from the measured lambda",
}
CANDIDATES = tuple(REASONS)
MOST_LEFT_OUT = 8  # with at most so many inputs, every input is left out in turn
LAG_SPAN = 20  # largest lag, in samples, of an input's correlation with the output
CHOSEN, WITHOUT, EXACT = "chosen", "without the controller", "controller exact"
BUDGET_SHARE = 0.4  # of the study's budget

Pairs = list[tuple[FloatArray, FloatArray]]


def candidates(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> tuple[str, ...]:
    """Return the candidate inputs.

    They are the paper's eleven candidates if the recordings have all of them and ``inputs`` are
    among them, else ``inputs``. Without ``inputs`` they are all columns except the output.
    Raises UsageError if no candidate is left.
    """
    common = [n for n in recordings[0].names if all(n in r.names for r in recordings)]
    names = tuple(inputs) or tuple(n for n in common if n != output)
    if inputs and set(CANDIDATES) <= set(common) and set(inputs) <= set(CANDIDATES):
        names = CANDIDATES
    if not names:
        raise UsageError(f"no input but the output {output}")
    return names


def selection(task: Task, _: Parts) -> dict[str, Any]:
    """Return principal components, a reason for every candidate, and free runs of input sets.

    Raises RecordingError or UsageError if a signal is missing or constant, or if recordings or
    budget are too short.
    """
    recordings, output, seed = task.recordings, task.output, task.settings.seed
    names = candidates(recordings, task.inputs, output)
    chosen = tuple(task.inputs) or names
    transform = output_transform(output)
    parts = _stretches(recordings, names, output)
    components = pca([(t, v[:, :-1]) for t, v in parts], names)
    sets = _sets(names, chosen, transform)
    same = aligned(recordings, names)
    budget = BUDGET_SHARE * task.settings.budget_minutes
    tried = try_sets(same, sets, output, seed=seed, budget_minutes=budget, jobs=task.jobs)
    if any(not np.isfinite(t.best.score) for t in tried):
        raise UsageError(f"the budget of {budget:g} min is too short for {len(sets)} sets")
    rows = scored_rows(tried)
    reach = None
    if CONTROLLER in chosen and transform == "phi":
        with_it = [t for t in tried if t.set.name in (CHOSEN, EXACT, WITHOUT)]
        reach = transparency(same, with_it, output)
    return {
        "output": output,
        "transform": transform,
        "candidates": list(names),
        "chosen": list(chosen),
        "simulated": sum(source_of(r.path, r.sha256) == "simulated" for r in recordings),
        "recordings": len(recordings),
        "pca": components,
        "variables": _variables([v for _, v in parts], names, chosen, components),
        "sets": [figures(t, rows) for t in tried],
        "comparisons": [_comparison(t, tried[0], rows, seed) for t in tried[1:]],
        "transparency": reach,
    }


def _sets(names: tuple[str, ...], chosen: tuple[str, ...], transform: str) -> list[InputSet]:
    sets = [InputSet(CHOSEN, chosen)]
    if set(names) != set(chosen):
        sets.append(InputSet("all candidates", names))
    if CONTROLLER in chosen and transform == "phi" and len(chosen) > 1:
        sets.append(InputSet(WITHOUT, tuple(n for n in chosen if n != CONTROLLER)))
        sets.append(InputSet(EXACT, chosen, exact=True))
    if len(sets) == 1 and 1 < len(chosen) <= MOST_LEFT_OUT:
        sets += [InputSet(f"without {n}", tuple(m for m in chosen if m != n)) for n in chosen]
    return sets


def _stretches(recordings: Sequence[Recording], names: Sequence[str], output: str) -> Pairs:
    """Return stretches of valid samples: time in s through all drives, candidates and output."""
    parts, begin_s = [], 0.0
    for recording in recordings:
        values = cleaned(recording, (*names, output), output_transform(output))
        good = np.asarray(np.isfinite(values).all(axis=1))
        parts += [(begin_s + recording.t_s[a:b], values[a:b]) for a, b in runs(good)]
        begin_s += len(recording.t_s) * recording.period_ns / 1e9
    files = ", ".join(str(r.path) for r in recordings)
    if sum(len(t) for t, _ in parts) <= 10 * (len(names) + 1):
        raise RecordingError(f"{files}: hardly a sample has {', '.join(names)} and {output} valid")
    spread = np.concatenate([v for _, v in parts]).std(axis=0)
    for name, value in zip((*names, output), spread, strict=True):
        if value <= 1e-12:
            raise RecordingError(f"{files}: {name} is constant; leave it out")
    return parts


def _variables(
    parts: Sequence[FloatArray],
    names: Sequence[str],
    chosen: Sequence[str],
    components: dict[str, Any],
) -> list[dict[str, Any]]:
    """Return correlation with the output, redundancy, loading and reason of every candidate."""
    values = np.concatenate(parts)
    among_all = variance_inflation(values[:, :-1])
    own = [i for i, n in enumerate(names) if n in chosen]
    among_chosen = dict(zip(own, variance_inflation(values[:, own]).tolist(), strict=True))
    loadings = np.array(components["loadings"])[:, : components["kept"]]
    rows = []
    for i, name in enumerate(names):
        by_lag = correlations([(v[:, i], v[:, -1]) for v in parts], LAG_SPAN)
        lag, component = (int(np.abs(each).argmax()) for each in (by_lag, loadings[i]))
        rows.append(
            {
                "name": name,
                "chosen": name in chosen,
                "correlation": by_lag[lag],
                "lag": lag,
                "inflation": float(among_all[i]),
                "inflation_chosen": among_chosen.get(i),
                "component": component + 1,
                "loading": float(loadings[i, component]),
                "reason": REASONS.get(name, ""),
            }
        )
    return rows


def _comparison(other: Tried, ours: Tried, rows: np.ndarray, seed: int) -> dict[str, Any]:
    """Return the comparison of another input set with the chosen one, with a verdict."""
    found = difference(other, ours, rows, seed)
    theirs, own = ([t.rmse(rows, start) for start in t.starts] for t in (other, ours))
    low, high, margin = found["low"], found["high"], NEGLIGIBLE * found["rmse"]
    if low > -margin and high < margin:
        verdict = "as good"
    elif low > 0.0 and min(theirs) > max(own):
        verdict = "worse"
    elif high < 0.0 and max(theirs) < min(own):
        verdict = "better"
    else:
        verdict = "not told apart"
    return {"name": other.set.name, **found, "verdict": verdict}
