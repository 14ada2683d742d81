"""Free runs of a network: on recordings in use, in the output's unit, with excerpts for figures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.runs import runs
from monitor.base.types import FloatArray
from training.narx.model_file import measured_and_predicted, measures
from training.narx.network import Spec
from training.narx.search import stages
from training.recordings.recording import Recording
from training.recordings.samples.preparation import (
    OTHER_WEIGHT,
    Prepared,
    Role,
    Samples,
    stretches_of,
)
from training.study.task import LAGS, Task

WINDOW = 50  # samples, Model Based Diagnosis of Oxygen Sensors, section 2
EXCERPT, SCATTER = 1200, 700  # samples in the figures


def scaled_as(data: Prepared, recordings: Sequence[Recording]) -> Prepared:
    """Return other recordings in the scaling of ``data``; all samples have the role TEST.

    The inputs are those that the monitor sees, without the noise that training adds to the
    controller.
    Raises RecordingError if no stretch can be used.
    """
    cut = stretches_of(recordings, data.names, data.output.name, data.transform, 8 * LAGS)
    valid = np.isfinite(cut.y)
    filled = np.interp(np.arange(len(cut.y)), np.flatnonzero(valid), cut.y[valid])
    return replace(
        data,
        samples=Samples(
            data.scaling.scale_u(cut.u),
            (filled - data.scaling.y_mean) / data.scaling.y_std,  # not clipped to the trained range
            np.where(cut.enabled, 1.0, OTHER_WEIGHT) * valid,
        ),
        segments=cut.segments,
        enabled=cut.enabled & valid,
        role=np.full(len(cut.y), Role.TEST, dtype=np.int8),
        recordings=tuple(recordings),
    )


def trained_on(task: Task, data: Prepared) -> Prepared:
    """Return the training recordings as the monitor sees them, in the scaling of ``data``."""
    return replace(scaled_as(data, task.recordings), role=task.data.role)


def judged_on(task: Task, data: Prepared) -> Prepared:
    """Return the held-out drives, or the training recordings without held-out drives.

    data : gives the scaling
    In both cases no sample of role TEST was used to train or choose a model.
    """
    return scaled_as(data, task.test) if task.test else trained_on(task, data)


@dataclass(frozen=True)
class FreeRun:
    """The free run of a network over samples, of which ``rows`` count."""

    data: Prepared
    predicted: FloatArray  # (n,) in model units
    rows: np.ndarray  # (n,) bool

    @classmethod
    def of(cls, data: Prepared, spec: Spec, weights: FloatArray) -> "FreeRun":
        """Run the network over ``data``; the rows are those of role TEST."""
        predicted = data.scaling.unscale_y(stages.free_run(data, spec, weights))
        return cls(data, predicted, data.role == Role.TEST)

    @property
    def in_units(self) -> tuple[FloatArray, FloatArray]:
        """Measured (NaN where not valid) and predicted output (n,), in the output's unit."""
        return measured_and_predicted(self.data, self.predicted)

    def judged(self, rows: np.ndarray) -> np.ndarray:
        """Return those of ``rows`` that the monitor judges, all of them if it judges hardly one."""
        on = rows & self.data.enabled
        return on if on.sum() > WINDOW else rows

    @property
    def residual(self) -> FloatArray:
        """Measured minus predicted output (n,), NaN where the monitor would not judge it."""
        measured, run = self.in_units
        return np.where(self.judged(self.rows), measured - run, np.nan)

    def errors(self) -> dict[str, Any]:
        """Return the measures on all rows and on the enabled ones."""
        return {
            name: measures(self.data, self.predicted, rows)
            for name, rows in (("all", self.rows), ("enabled", self.rows & self.data.enabled))
        }

    def view(self, title: str, source: str) -> dict[str, Any]:
        """Return errors, an excerpt and a scatter of the rows, as figure 6 of the paper."""
        scored = self.rows & np.isfinite(self.in_units).all(axis=0)
        judged = self.judged(scored)
        first, stop = _liveliest(self.in_units[0], judged, scored)
        some = np.flatnonzero(judged)[:: max(1, -(-int(judged.sum()) // SCATTER))]
        series = dict(zip(("measured", "predicted"), self.in_units, strict=True))
        return {
            "title": title,
            "source": source,
            "all": measures(self.data, self.predicted, scored),
            "enabled": measures(self.data, self.predicted, judged),
            "excerpt": {k: np.where(scored, v, np.nan)[first:stop] for k, v in series.items()},
            "judged": judged[first:stop].astype(int),
            "scatter": {k: v[some] for k, v in series.items()},
        }


def _liveliest(measured: FloatArray, judged: np.ndarray, scored: np.ndarray) -> tuple[int, int]:
    """Return first and stop row of a lively excerpt of at most ``EXCERPT`` samples.

    All excerpts of unbroken stretches are sorted by the variation of their judged samples; the one
    at the 75th percentile is taken.
    """
    places = []
    for a, b in runs(scored):
        length = min(EXCERPT, b - a)
        for at in range(a, b - length + 1, max(length // 2, 1)):
            on = judged[at : at + length]
            spread = float(measured[at : at + length][on].std()) if on.any() else 0.0
            places.append((length * float(on.mean()) * spread, at, at + length))
    places.sort()
    return places[(3 * len(places)) // 4][1:] if places else (0, 0)
