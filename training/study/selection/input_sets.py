"""Comparison of input sets: the same small NARX, in free run on the same samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.narx.cross_fit import as_recorded
from training.narx.search.stages import Trained, free_run
from training.recordings import metrics
from training.recordings.recording import Recording
from training.recordings.samples.augmentation import CONTROLLER
from training.recordings.samples.preparation import Prepared, Role, columns_of, prepare
from training.study.narx.models import Recipe, trained

LAGS, HIDDEN, HORIZONS, STARTS = 5, (8,), (5, 20, 100), 2  # lags and horizons in samples
MOST_TRAINING = 24_000  # samples, enough for a few hundred weights; the rest is for testing
WINDOW = 1800  # samples of a part that as a whole trains or tests


@dataclass(frozen=True, slots=True)
class InputSet:
    """A set of inputs; ``exact`` trains on lambda_controller without the usual added noise."""

    name: str
    inputs: tuple[str, ...]
    exact: bool = False


@dataclass(frozen=True, slots=True)
class Tried:
    """The trained networks of one input set."""

    set: InputSet
    data: Prepared
    starts: Sequence[Trained]

    @property
    def best(self) -> Trained:
        """The start with the lowest free-run validation error."""
        return min(self.starts, key=lambda t: t.score)

    def predicted(self, start: Trained | None = None) -> FloatArray:
        """Return the free run (n,) of a start, by default of the best, in model units."""
        own = start or self.best
        return self.data.scaling.unscale_y(free_run(self.data, own.spec, own.weights))


def aligned(recordings: Sequence[Recording], names: Sequence[str]) -> list[Recording]:
    """Return the recordings with a sample invalid in all ``names`` if it is invalid in one.

    This gives all input sets the same stretches and the same held-out blocks.
    """
    result = []
    for recording in recordings:
        values = np.array(recording.values, dtype=np.float64)
        own = columns_of(recording, names, {})
        own[~np.isfinite(own).all(axis=1)] = np.nan
        values[:, [list(recording.names).index(name) for name in names]] = own
        result.append(replace(recording, values=values))
    return result


def try_sets(
    recordings: Sequence[Recording],
    sets: Sequence[InputSet],
    output: str,
    *,
    seed: int,
    budget_minutes: float,
    jobs: int = 2,
) -> list[Tried]:
    """Return the input sets, all trained with the same recipe and number of starts.

    recordings : from ``aligned``
    budget_minutes : for all trainings together, shared equally
    """
    prepared = [_prepared(recordings, each, output, seed) for each in sets]
    number = STARTS * len(sets)
    share = budget_minutes * min(jobs, number) / number
    found = trained(prepared, Recipe(LAGS, HIDDEN, STARTS, seed, share, HORIZONS), jobs)
    return [Tried(*each) for each in zip(sets, prepared, found, strict=True)]


def _prepared(recordings: Sequence[Recording], each: InputSet, output: str, seed: int) -> Prepared:
    """Return the data of a set; windows beyond ``MOST_TRAINING`` samples become test samples."""
    data = prepare(recordings, each.inputs, output, lags=LAGS, seed=seed)
    samples, role = data.samples, data.role.copy()
    if each.exact and CONTROLLER in each.inputs:
        samples = replace(samples, u=as_recorded(data).u)
    keep = min(1.0, MOST_TRAINING / len(role))
    for s in data.segments:
        window = (s.first + np.arange(s.stop - s.start)) // WINDOW
        kept = np.floor((window + 1) * keep) > np.floor(window * keep)
        role[s.start : s.stop][~kept] = Role.TEST
    return replace(data, samples=samples, role=role)


def scored_rows(tried: Sequence[Tried]) -> np.ndarray:
    """Return a mask (n,) bool of the enabled test samples that all sets predict.

    If no test sample is enabled, all test samples count.
    """
    data = tried[0].data
    valid = (data.role == Role.TEST) & (data.samples.weight > 0)
    for each in tried:
        valid &= np.isfinite([each.predicted(t) for t in each.starts]).all(axis=0)
    enabled = valid & data.enabled
    return enabled if enabled.any() else valid


def figures(tried: Tried, rows: np.ndarray) -> dict[str, Any]:
    """Return the free-run errors of an input set on ``rows``, in model units."""
    measured = tried.data.scaling.unscale_y(tried.data.samples.y[rows])
    found = metrics.measures(measured, tried.predicted()[rows])
    return {
        "name": tried.set.name,
        "inputs": list(tried.set.inputs),
        **{name: found[name] for name in ("samples", "rmse", "fit_percent", "correlation")},
        "rmse_of_starts": [metrics.rmse(measured, tried.predicted(t)[rows]) for t in tried.starts],
        "stopped_by_budget": sum(start.cut_short for start in tried.starts),
    }
