"""The model file of a training: its graph, its card with measures, its parity proved."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from monitor.model.card import ModelCard, TrainingRecording
from monitor.model.step import from_model_units
from training.narx.export import Network, save
from training.narx.parity import parity
from training.narx.search.stability import Contraction
from training.narx.search.stages import Trained, free_run
from training.narx.work import Work
from training.recordings import metrics
from training.recordings.recording import training_recording
from training.recordings.samples.preparation import Prepared, Role

PARITY_SAMPLES = 3000
PACKAGES = ("numpy", "onnx", "onnxruntime", "scipy")  # whose versions stand in the card


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Rows first .. stop - 1 of a recording that no training step saw."""

    recording: int
    first: int
    stop: int
    role: str  # "validate" chose the weights, "test" chose nothing


def held_out(data: Prepared) -> tuple[HeldOut, ...]:
    """Return the held-out ranges in rows of their recordings."""
    result = []
    for segment in data.segments:
        role = data.role[segment.start : segment.stop]
        edges = [0, *(np.flatnonzero(np.diff(role)) + 1).tolist(), len(role)]
        for a, b in pairwise(edges):
            if role[a] != Role.TRAIN:
                name = Role(int(role[a])).name.lower()
                result.append(
                    HeldOut(segment.recording, segment.first + a, segment.first + b, name)
                )
    return tuple(result)


def recordings_of(data: Prepared) -> tuple[TrainingRecording, ...]:
    """Return the recordings for a card, each with the number of samples that it gave."""
    samples = [0] * len(data.recordings)
    for segment in data.segments:
        samples[segment.recording] += segment.stop - segment.start
    return tuple(map(training_recording, data.recordings, samples))


def measures(data: Prepared, predicted: FloatArray, rows: np.ndarray) -> dict[str, float]:
    """Return free-run measures on the predicted samples among ``rows``, in the output's unit."""
    rows = rows & np.isfinite(predicted) & (data.samples.weight > 0)
    measured = data.scaling.unscale_y(data.samples.y[rows])
    a, b = (from_model_units(data.transform, x) for x in (measured, predicted[rows]))
    if len(a) < 2 or a.std() == 0:
        return {"samples": float(len(a))}
    return {
        "samples": float(len(a)),
        "rmse": metrics.rmse(a, b),
        "fit_percent": metrics.fit_percent(a, b),
        "correlation": metrics.correlation(a, b),
        "slope": metrics.slope(a, b),
        "residual_mean": float((a - b).mean()),
        "residual_std": float((a - b).std()),
        "rmse_model_units": metrics.rmse(measured, predicted[rows]),
    }


def write_model(
    out: Path | str,
    data: Prepared,
    model: Trained,
    gap: Contraction,
    unseen: Mapping[str, Any] | None = None,
    work: Work | None = None,
) -> tuple[Network, ModelCard, FloatArray]:
    """Write a training as a model file; return its network, its card and its free run.

    unseen : measures of twins that did not see what they predict, for the card
    work : of the training, for the card
    The free run is that over ``data.samples``, (n,) in model units, NaN at the beginnings.
    Raises ModelError if ONNX and numpy disagree.
    """
    network = Network(
        spec=model.spec,
        weights=model.weights,
        scaling=data.scaling,
        transform=data.transform,
        transforms=data.transforms,
        inputs=data.names,
    )
    predicted = data.scaling.unscale_y(free_run(data, model.spec, model.weights))
    checks: dict[str, Any] = {"contraction": gap.to_card()}
    if work:
        checks["work"] = {"counted": work.spent, "ended_by_wall": work.ended_by_wall}
    card = card_of(
        data,
        predicted,
        kind="narx",
        transforms=data.transforms,
        checks=checks,
        **shape_of(network, model.members),
    )
    save(out, network, card)
    checks = {**checks, "parity": _parity(out, network, data)}
    card = replace(card, checks=checks, fit={**card.fit, **({"unseen": unseen} if unseen else {})})
    save(out, network, card)
    return network, card, predicted


def _parity(out: Path | str, network: Network, data: Prepared) -> dict[str, float]:
    segment = max(data.segments, key=lambda s: s.stop - s.start)
    recording = data.recordings[segment.recording]
    order = [list(recording.names).index(name) for name in network.inputs]
    n = min(PARITY_SAMPLES, segment.stop - segment.start)
    u = recording.values[segment.first : segment.first + n, order]
    y = data.scaling.unscale_y(data.samples.y[segment.start : segment.start + n])
    return asdict(parity(out, network, u, y))


def shape_of(network: Network, members: int = 1) -> dict[str, Any]:
    """Return the fields of a card that the shape of a network decides."""
    return {
        "lags": network.spec.memory,
        "input_lag_start": network.spec.boxes[0][0],
        "layers": network.spec.hidden,
        "state": network.state_layout,
        "structure": {
            "input_boxes": [list(box) for box in network.spec.boxes],
            "output_lags": network.spec.lags,
            "linear_path": network.spec.linear_path,
            "members": members,
        },
    }


def card_of(data: Prepared, predicted: FloatArray, **own: Any) -> ModelCard:
    """Return the card of a model that was fitted to ``data``.

    predicted : (n,) free run over ``data.samples`` in model units, for the measures
    own : fields that depend on the kind of model
    """
    test = data.role == Role.TEST
    everything, enabled = (measures(data, predicted, rows) for rows in (test, test & data.enabled))
    return ModelCard(
        inputs=data.inputs,
        output=data.output,
        transform=data.transform,
        output_limits=(data.scaling.y_low, data.scaling.y_high),
        period_ns=data.period_ns,
        recordings=recordings_of(data),
        residual_mean=enabled.get("residual_mean", 0.0),
        residual_std=enabled.get("residual_std", everything.get("residual_std", 0.0)),
        fit={"test": everything, "test_enabled": enabled},
        packages={name: version(name) for name in PACKAGES},
        **own,
    )
