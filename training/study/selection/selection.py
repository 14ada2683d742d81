"""Inputs of the model, their reasons, and the error of other input sets."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import linalg

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from training.jobs.json_tree import json_tree
from training.recordings.metrics import correlations
from training.recordings.recording import Recording
from training.recordings.samples.augmentation import CONTROLLER
from training.recordings.samples.linear_data import linear_stretches
from training.recordings.samples.preparation import output_transform
from training.study.selection.input_sets import InputSet, aligned, figures, scored_rows, try_sets
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
ENOUGH = 0.9  # share of the variance that the kept components explain
BUDGET_SHARE = 0.4  # of the study's budget


def candidates(recordings: Sequence[Recording], inputs: tuple[str, ...]) -> tuple[str, ...]:
    """Return the candidate inputs.

    They are the paper's eleven candidates if the recordings have all of them and ``inputs`` are
    among them, else ``inputs``.
    """
    common = set[str].intersection(*({*r.names} for r in recordings))
    return CANDIDATES if {*inputs} <= {*CANDIDATES} <= common else inputs


def selection(task: Task, _: Parts) -> dict[str, Any]:
    """Return principal components, a reason for every candidate, and free runs of input sets.

    Raises RecordingError or UsageError if a signal is missing or constant, or if recordings or
    budget are too short.
    """
    recordings, output, seed = task.recordings, task.output, task.settings.seed
    names, chosen = candidates(recordings, task.inputs), task.inputs
    transform = output_transform(output)
    parts = [p.values for p in linear_stretches(recordings, names, output)[0]]
    values = np.concatenate(parts)
    if len(values) <= 10 * (len(names) + 1):
        listed = ", ".join((*names, output))
        raise RecordingError(f"{len(values)} samples with {listed} all valid are too few")
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
        "pca": pca(values[:, :-1], names),
        "variables": _variables(parts, names, chosen),
        "sets": [figures(t, rows) for t in tried],
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


def _variables(
    parts: Sequence[FloatArray], names: Sequence[str], chosen: Sequence[str]
) -> list[dict[str, Any]]:
    """Return correlation with the output, redundancy and reason of every candidate."""
    values = np.concatenate(parts)
    among_all = _inflation(values[:, :-1])
    own = [i for i, n in enumerate(names) if n in chosen]
    among_chosen = dict(zip(own, _inflation(values[:, own]).tolist(), strict=True))
    rows = []
    for i, name in enumerate(names):
        by_lag = correlations([(v[:, i], v[:, -1]) for v in parts], LAG_SPAN)
        lag = int(np.abs(by_lag).argmax())
        rows.append(
            {
                "name": name,
                "chosen": name in chosen,
                "correlation": by_lag[lag],
                "lag": lag,
                "inflation": float(among_all[i]),
                "inflation_chosen": among_chosen.get(i),
                "reason": REASONS.get(name, ""),
            }
        )
    return rows


def _inflation(values: FloatArray) -> FloatArray:
    """Return the variance inflation factor 1 / (1 - R²) of each column of ``values`` (n, k)."""
    among = np.atleast_2d(np.corrcoef(values.T))
    return np.diag(linalg.inv(among + 1e-12 * np.eye(len(among))))


def pca(values: FloatArray, names: Sequence[str]) -> dict[str, Any]:
    """Return the principal components of the z-scored columns as plain values.

    values : (n, k), with n > k and no constant column; ``names`` are those of the columns
    The variances are in falling order. With more than one component the last is never kept.
    """
    z = (values - values.mean(axis=0)) / values.std(axis=0, ddof=1)
    _, sizes, rows = linalg.svd(z, full_matrices=False)
    variances = sizes**2 / (len(values) - 1.0)
    explained = np.cumsum(variances) / variances.sum()
    signs = np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])
    result = {
        "names": list(names),
        "samples": len(values),
        "kept": max(1, min(int(np.searchsorted(explained, ENOUGH) + 1), len(variances) - 1)),
        "variances": variances,
        "explained": explained,
        "loadings": (rows * signs[:, np.newaxis]).T,  # one column each, the largest is positive
    }
    return dict(json_tree(result))
