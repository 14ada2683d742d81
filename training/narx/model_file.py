"""The model file of a training: its graph, its card with measures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model, from_model_units
from training.narx.export import Network
from training.narx.network import Spec
from training.recordings import metrics
from training.recordings.recording import Recording, training_recording
from training.recordings.samples.preparation import Prepared, Role

ALL_OF_A_CHAIN = "the recordings of the fit, which changed a few constants only"
ALL_OF_A_NETWORK = "the recordings that trained the network, too little or too briefly for twins"
OF_TWINS = "the recordings of the training, each predicted by a twin that had not seen it"
PACKAGES = ("numpy", "onnx", "onnxruntime", "scipy")  # whose versions stand in the card
Unseen = Sequence[tuple[Model, Sequence[Recording]]]  # models, each with drives it has not seen


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeRunFit:
    """What the fit of any kind of model returns."""

    path: Path
    card: ModelCard
    data: Prepared
    predicted: FloatArray  # (n,) free run over data.samples in model units, NaN at the beginnings
    seconds: float
    warnings: tuple[str, ...]

    @property
    def in_units(self) -> tuple[FloatArray, FloatArray]:
        """Measurement and free run (n,) in the output's unit; NaN where there is none."""
        return measured_and_predicted(self.data, self.predicted)

    def healthy(self) -> tuple[Unseen, str]:
        """Return what sets the limits: models with drives that they have not seen, and its name.

        Here the model itself, whose few constants a recording hardly moves.
        """
        return [(Model.load(self.path), self.data.recordings)], ALL_OF_A_CHAIN


def measured_and_predicted(data: Prepared, predicted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the measurement, NaN where it is not valid, and a free run (n,), in its unit.

    predicted : (n,) in model units
    """
    measured = np.where(data.samples.weight > 0, data.scaling.unscale_y(data.samples.y), np.nan)
    return from_model_units(data.transform, measured), from_model_units(data.transform, predicted)


def measures(data: Prepared, predicted: FloatArray, rows: np.ndarray) -> dict[str, float]:
    """Return free-run measures on the predicted samples among ``rows``, in the output's unit."""
    rows = rows & np.isfinite(predicted) & (data.samples.weight > 0)
    measured = data.scaling.unscale_y(data.samples.y[rows])
    a, b = (from_model_units(data.transform, x) for x in (measured, predicted[rows]))
    if len(a) < 2 or np.ptp(a) == 0.0:
        return {"samples": float(len(a))}
    in_model_units = metrics.rmse(measured, predicted[rows])
    return metrics.measures(a, b) | {"samples": float(len(a)), "rmse_model_units": in_model_units}


def recorded(data: Prepared, names: Sequence[str]) -> FloatArray:
    """Return signals of all samples (n, n_names) as they were recorded, in physical units."""
    parts = []
    for s in data.segments:
        recording = data.recordings[s.recording]
        order = [recording.names.index(name) for name in names]
        parts.append(recording.values[s.first : s.first + s.stop - s.start, order])
    return np.concatenate(parts)


def network_of(data: Prepared, spec: Spec, weights: FloatArray) -> Network:
    """Return the network with the scaling and inputs of its data."""
    return Network(spec, weights, data.scaling, data.transform, data.names)


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


def card_of(
    data: Prepared, predicted: FloatArray, *, unseen: Mapping[str, Any] | None = None, **own: Any
) -> ModelCard:
    """Return the card of a model that was fitted to ``data``.

    predicted : (n,) free run over ``data.samples`` in model units, for the measures
    unseen : measures of twins
    own : fields that depend on the kind of model
    """
    test, samples = data.role == Role.TEST, [0] * len(data.recordings)
    for segment in data.segments:
        samples[segment.recording] += segment.stop - segment.start
    everything, enabled = (measures(data, predicted, rows) for rows in (test, test & data.enabled))
    return ModelCard(
        inputs=data.inputs,
        output=data.output,
        transform=data.transform,
        output_limits=(data.scaling.y_low, data.scaling.y_high),
        period_ns=data.period_ns,
        recordings=tuple(map(training_recording, data.recordings, samples)),
        residual_mean=enabled.get("residual_mean", 0.0),
        residual_std=enabled.get("residual_std", everything.get("residual_std", 0.0)),
        fit={"test": everything, "test_enabled": enabled} | ({"unseen": unseen} if unseen else {}),
        packages={name: version(name) for name in PACKAGES},
        **own,
    )
