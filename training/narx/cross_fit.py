"""Cross-fit: the free run over every recording by a twin that did not see it.

A twin has the model's shape and begins at new random weights. Trained on from the model's weights
it would keep what these know of the recording that it must not see. It is the mean of a few short
trainings, since one alone may be far off where the others are not.
Source: Stone, Cross-validatory choice and assessment of statistical predictions, J. Royal
Statistical Society B 36 (1974).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, FloatArray, IntArray
from monitor.model.card import ModelCard
from monitor.model.step import Model, to_model_units
from training.jobs.model_bytes import model_of
from training.narx.export import Network, build, file_content
from training.narx.model_file import measures, network_of, recorded, shape_of
from training.narx.network import Spec
from training.narx.search.mean import mean_of
from training.narx.search.stages import HORIZONS, N_SAMPLES, Trained, free_run, train
from training.narx.search.structure import FOLDS, STARTS
from training.narx.work import Work
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, Samples


@dataclass(frozen=True, slots=True)
class Twin:
    """A network that saw none of the samples in ``rows``."""

    network: Network
    rows: BoolArray  # (n,) of the samples

    def model(self, card: ModelCard) -> Model:
        """Return the twin as a model with the card of the whole training's, but its own shape."""
        own = replace(card, **shape_of(self.network))
        return model_of("twin.onnx", file_content(build(self.network), own))


@dataclass(frozen=True, slots=True)
class CrossFit:
    """What the twins predict where they were not trained."""

    data: Prepared  # with the samples as they were recorded, test where a twin predicts
    predicted: FloatArray  # (n,) in model units, NaN where no twin predicts
    twins: tuple[Twin, ...]

    def unseen(self, card: ModelCard) -> Iterator[tuple[Model, list[Recording]]]:
        """Yield each twin as a model with the parts of recordings that it did not see.

        card : of the model whose twins these are
        """
        for twin in self.twins:
            parts = []
            for s in self.data.segments:
                own = np.flatnonzero(twin.rows[s.start : s.stop])
                if len(own):
                    first, stop = s.first + int(own[0]), s.first + int(own[-1]) + 1
                    parts.append(self.data.recordings[s.recording].part(first, stop))
            yield twin.model(card), parts

    def to_card(self) -> dict[str, Any]:
        """Return the measures on the enabled samples of each recording, {} without a twin."""
        found = []
        for number, recording in enumerate(self.data.recordings):
            rows = self.data.enabled & (_recording_of(self.data) == number)
            own = measures(self.data, self.predicted, rows)
            if "rmse" in own:
                found.append({"path": Path(recording.path).name, **own})
        return {"recordings": found} if found else {}


def cross_fit(
    data: Prepared,
    spec: Spec,
    *,
    decay: float = 0.0,
    seed: int = 0,
    work: Work | None = None,
    threads: int = 1,
) -> CrossFit:
    """Train a twin of the shape ``spec`` without each recording and let it run over that one.

    A single recording is cut into four blocks; of more than four recordings each twin misses
    several. A twin for which too few samples are left is not trained.
    work : budget, of which each twin has an equal part
    """
    untouched = replace(data, samples=as_recorded(data))
    work = work or Work()

    def one(rows: BoolArray, part: Work) -> tuple[Twin, FloatArray] | None:
        members = _trained(data, spec, rows, decay, seed, part)
        if not members:
            return None
        shape, weights = mean_of([(each.spec, each.weights) for each in members])
        return Twin(network_of(data, shape, weights), rows), free_run(untouched, shape, weights)

    found = [each for each in work.side_by_side(one, _left_out(data), threads) if each]
    predicted = np.full(len(data.role), np.nan)
    for twin, run in found:
        predicted[twin.rows] = data.scaling.unscale_y(run[twin.rows])
    role = np.where(np.isfinite(predicted), Role.TEST, Role.TRAIN).astype(data.role.dtype)
    twins = tuple(twin for twin, _ in found)
    return CrossFit(replace(untouched, role=role), predicted, twins)


def _left_out(data: Prepared) -> list[BoolArray]:
    """Return the rows (n,) that each twin does not see."""
    part = _recording_of(data)
    if part.min() == part.max():
        part = np.repeat(np.arange(FOLDS), [len(block) for block in np.array_split(part, FOLDS)])
    numbers = np.unique(part)
    return [np.isin(part, group) for group in np.array_split(numbers, min(len(numbers), FOLDS))]


def _recording_of(data: Prepared) -> IntArray:
    """Return the number of each sample's recording (n,)."""
    return np.repeat(*np.array([(s.recording, s.stop - s.start) for s in data.segments]).T)


def _trained(
    data: Prepared, spec: Spec, rows: BoolArray, decay: float, seed: int, work: Work
) -> list[Trained]:
    """Return trainings without ``rows``, as many as the work allows, none if the rest is too short.

    Blocks that chose the weights stop them. Where none is left, those of the test do.
    """
    role = data.role.copy()
    if (role[~rows] == Role.VALIDATE).any():
        role[role == Role.TEST] = Role.TRAIN
    else:
        role[role == Role.TEST] = Role.VALIDATE
    role[rows] = Role.TEST
    seen, horizons, found = replace(data, role=role), HORIZONS[:-1], list[Trained]()
    if seen.n_train < spec.n_weights:
        return []
    for start in range(STARTS):
        own = work.up_to(work.left)
        try:
            begun = Trained(spec, decay=decay, seed=seed + start)
            trained = train(seen, begun, own, horizons, N_SAMPLES)
        except RecordingError:  # no validation block is longer than the memory
            return []
        work.join(own)
        if not np.isfinite(trained.score) or (found and own.is_over()):
            break
        found.append(trained)
    return found


def as_recorded(data: Prepared) -> Samples:
    """Return the scaled samples without the changes that training makes to them."""
    u = recorded(data, data.names)
    y = to_model_units(data.transform, recorded(data, [data.output.name])[:, 0])
    valid = np.flatnonzero(data.samples.weight > 0)
    filled = np.interp(np.arange(len(y)), valid, y[valid])
    scaling = data.scaling
    return Samples(scaling.scale_u(u), scaling.scale_y(filled), data.samples.weight)
