"""Cross-fit: the free run over every recording by a twin that did not see it.

A twin is the mean of the search's best trainings that left the recording out.
Source: Stone, Cross-validatory choice and assessment of statistical predictions, J. Royal
Statistical Society B 36 (1974).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model, to_model_units
from training.narx.export import Network, save
from training.narx.model_file import measures, network_of, shape_of
from training.narx.search.mean import mean_of
from training.narx.search.stages import Trained, free_run
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, Samples
from training.recordings.samples.rows import runs
from training.recordings.samples.transforms import apply


@dataclass(frozen=True, slots=True)
class Twin:
    """A network that saw none of the samples in ``rows``."""

    network: Network
    rows: BoolArray  # (n,) of the samples

    def model(self, card: ModelCard) -> Model:
        """Return the twin as a model with the card of the whole training's, but its own shape."""
        with TemporaryDirectory(prefix="o2-twin-") as folder:
            path = Path(folder) / "twin.onnx"
            save(path, self.network, replace(card, **shape_of(self.network)))
            return Model.load(path)


@dataclass(frozen=True, slots=True)
class CrossFit:
    """What the twins predict where they were not trained."""

    data: Prepared  # with the samples as they were recorded
    predicted: FloatArray  # (n,) in model units, NaN where no twin predicts
    twins: tuple[Twin, ...]

    def unseen(self, card: ModelCard) -> Iterator[tuple[Model, list[Recording]]]:
        """Yield each twin as a model with the parts of recordings that it did not see.

        card : of the model whose twins these are
        """
        for twin in self.twins:
            parts = []
            for s in self.data.segments:
                for first, stop in runs(twin.rows[s.start : s.stop]):
                    rows = slice(s.first + first, s.first + stop)
                    whole = self.data.recordings[s.recording]
                    values, quality = whole.values[rows], whole.quality[rows]
                    parts.append(replace(whole, values=values, quality=quality))
            yield twin.model(card), parts

    def to_card(self) -> dict[str, Any]:
        """Return the measures on enabled samples of all recordings together and of each.

        Nothing if no twin was trained.
        """
        data, enabled = self.data, self.data.enabled
        found = []
        for number, recording in enumerate(data.recordings):
            own = measures(data, self.predicted, enabled & _of_recordings(data, [number]))
            if "rmse" in own:
                found.append({"path": Path(recording.path).name, **own})
        pooled = measures(data, self.predicted, enabled)
        return {"recordings": found, **pooled} if found else {}


def cross_fit(data: Prepared, folds: Sequence[Prepared], trained: Sequence[Trained]) -> CrossFit:
    """Return what the trainings predict of the samples that their folds left out.

    data : all samples, with which the folds were made
    A fold without a training has no twin.
    """
    recorded = replace(data, samples=as_recorded(data))
    predicted, twins = np.full(len(data.role), np.nan), []
    for number, each in enumerate(folds):
        own = [(t.spec, t.weights) for t in trained if t.fold == number and np.isfinite(t.score)]
        if own:
            shape, weights = mean_of(own)
            rows = each.role == Role.TEST
            run = data.scaling.unscale_y(free_run(recorded, shape, weights))
            predicted[rows] = run[rows]
            twins.append(Twin(network_of(data, shape, weights), rows))
    return CrossFit(recorded, predicted, tuple(twins))


def unseen_words(unseen: Mapping[str, Any]) -> str:
    """Return the fit of a card's unseen recordings in words."""
    each = unseen["recordings"]
    if len(each) == 1:
        return f"unseen blocks of the recording: fit {unseen['fit_percent']:.0f} %"
    worst = min(each, key=lambda r: r["fit_percent"])
    return (
        f"unseen recordings: fit {unseen['fit_percent']:.0f} %, "
        f"worst {worst['fit_percent']:.0f} % ({worst['path']})"
    )


def _of_recordings(data: Prepared, numbers: list[int]) -> BoolArray:
    rows = np.zeros(len(data.role), dtype=bool)
    for s in data.segments:
        rows[s.start : s.stop] = s.recording in numbers
    return rows


def as_recorded(data: Prepared) -> Samples:
    """Return the scaled samples without the changes that training makes to them."""
    inputs, outputs = [], []
    for s in data.segments:
        recording, rows = data.recordings[s.recording], slice(s.first, s.first + s.stop - s.start)
        order = [recording.names.index(name) for name in data.names]
        inputs.append(recording.values[rows, order])
        outputs.append(recording.values[rows, recording.names.index(data.output.name)])
    u = apply(data.transforms, data.names, np.concatenate(inputs))
    y = to_model_units(data.transform, np.concatenate(outputs))
    valid = np.flatnonzero(data.samples.weight > 0)
    filled = np.interp(np.arange(len(y)), valid, y[valid])
    scaling = data.scaling
    return Samples(scaling.scale_u(u), scaling.scale_y(filled), data.samples.weight)
