"""Fit a NARX to recordings: prepare, train from several starts, export, check."""

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.errors import RecordingError, UsageError
from monitor.manifest import source_of
from monitor.model import from_model_units
from monitor.model_card import ModelCard, TrainingRecording
from monitor.types import FloatArray
from training import metrics
from training.export import Network, save
from training.narx import Spec
from training.parity import parity
from training.prepare import Prepared, Role, prepare
from training.stability import CONTRACTION_SAMPLES, Contraction, contraction
from training.stages import Trained, free_run, train

if TYPE_CHECKING:
    from training.recordings import Recording

PARITY_SAMPLES = 3000
SAMPLES_PER_WEIGHT = 10  # fewer than this and the network overfits, whatever one does


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Rows first .. stop - 1 of a recording that no training step saw."""

    recording: int
    first: int
    stop: int
    role: str  # "validate" chose the weights, "test" chose nothing


@dataclass(frozen=True, slots=True)
class FitResult:
    """The model and how it was obtained."""

    path: Path
    card: ModelCard
    network: Network
    data: Prepared
    starts: tuple[Trained, ...]
    best: int  # which start
    predicted: FloatArray  # (n,) free run over data.samples in model units, NaN at the beginnings
    held_out: tuple[HeldOut, ...]
    seconds: float
    warnings: tuple[str, ...]


def fit(
    recordings: "Sequence[Recording]",
    inputs: Sequence[str],
    output: str,
    out: Path | str,
    *,
    lags: int = 5,
    hidden: tuple[int, ...] = (8, 8),
    input_lag_start: int = 1,
    transforms: Sequence[Mapping[str, Any]] = (),
    starts: int = 3,
    budget_minutes: float = 10.0,
    seed: int = 0,
    threads: int = 2,
    progress: Callable[[int, int, int, float], None] | None = None,
) -> FitResult:
    """Train on ``recordings`` and write the model file ``out``.

    transforms : of inputs, see ``training.transforms``
    progress : called with start, horizon, epoch and best validation RMSE after every epoch
    Raises RecordingError or UsageError if the recordings or names cannot be used.
    """
    if starts < 1:
        raise UsageError(f"starts {starts}: must be at least 1")
    began = time.monotonic()
    data = prepare(recordings, inputs, output, transforms, lags=lags, seed=seed)
    scale = data.scaling
    spec = Spec(
        len(inputs), lags, tuple(hidden), input_lag_start,
        float(scale.scale_y(scale.y_low)), float(scale.scale_y(scale.y_high)),
    )  # fmt: skip
    warnings = [*data.warnings, *_size_warnings(data, spec)]

    workers = max(1, min(threads, starts))
    rounds = -(-starts // workers)

    def one(index: int) -> Trained:
        told = (lambda h, e, s: progress(index, h, e, s)) if progress else None
        share = (index // workers + 1) / rounds  # later starts get their part of the budget
        return train(data, spec, seed + 1000 * index, began + share * 60.0 * budget_minutes, told)

    with ThreadPoolExecutor(workers) as pool:
        trained = tuple(pool.map(one, range(starts)))
    best, gap = _choose(data, spec, trained, seed)
    if not np.isfinite(trained[best].score):
        raise UsageError(f"the budget of {budget_minutes:g} min ended before the first epoch")
    warnings += _training_warnings(trained, gap)
    network = Network(
        spec, trained[best].weights, scale, data.transform, data.transforms, tuple(inputs)
    )
    predicted = scale.unscale_y(free_run(data, spec, trained[best].weights))
    checks = {
        "contraction": {"gap": gap.gap, "samples": CONTRACTION_SAMPLES, "pairs": gap.pairs,
                        "limit": gap.limit},
    }  # fmt: skip
    card = _card(data, network, predicted, checks)
    save(out, network, card)
    checks["parity"] = _parity(out, network, data)
    save(out, network, card := _card(data, network, predicted, checks))
    return FitResult(
        Path(out), card, network, data, trained, best, predicted, held_out(data),
        time.monotonic() - began, tuple(warnings),
    )  # fmt: skip


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


def measures(data: Prepared, predicted: FloatArray, rows: np.ndarray) -> dict[str, float]:
    """Return free-run measures in the output's unit on ``rows`` that have a prediction."""
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


def _choose(
    data: Prepared, spec: Spec, trained: Sequence[Trained], seed: int
) -> tuple[int, Contraction]:
    """Return the best start; one that forgets its history comes before one that does not."""
    gaps = [contraction(data, spec, t.weights, seed) for t in trained]
    best = min(
        range(len(trained)), key=lambda i: (not gaps[i].gap <= gaps[i].limit, trained[i].score)
    )
    return best, gaps[best]


def _training_warnings(trained: Sequence[Trained], gap: Contraction) -> list[str]:
    warnings = []
    if not gap.gap <= gap.limit:
        warnings.append(
            f"predictions from two histories differ by up to {gap.gap:.3g} after "
            f"{CONTRACTION_SAMPLES} samples (limit {gap.limit:.3g})"
        )
    cut = sum(t.stages[-1].stop == "budget" if t.stages else True for t in trained)
    if cut:
        warnings.append(f"the budget ended {cut} of {len(trained)} starts before their last stage")
    return warnings


def _size_warnings(data: Prepared, spec: Spec) -> list[str]:
    n = int(((data.role == Role.TRAIN) & (data.samples.weight > 0)).sum())
    if n < spec.n_weights:
        raise RecordingError(
            f"{n} training samples for {spec.n_weights} weights are too few: "
            "record more or use a smaller model (--hidden, --lags)"
        )
    if n < SAMPLES_PER_WEIGHT * spec.n_weights:
        return [f"{n} training samples for {spec.n_weights} weights: expect overfitting"]
    return []


def _parity(out: Path | str, network: Network, data: Prepared) -> dict[str, float]:
    segment = max(data.segments, key=lambda s: s.stop - s.start)
    recording = data.recordings[segment.recording]
    order = [list(recording.names).index(name) for name in network.inputs]
    n = min(PARITY_SAMPLES, segment.stop - segment.start)
    u = recording.values[segment.first : segment.first + n, order]
    y = data.scaling.unscale_y(data.samples.y[segment.start : segment.start + n])
    result = parity(out, network, u, y)
    return {"samples": result.samples, "onnx_numpy": result.onnx_numpy,
            "torch_numpy": result.torch_numpy, "tolerance": result.tolerance}  # fmt: skip


def _card(
    data: Prepared, network: Network, predicted: FloatArray, checks: Mapping[str, Any]
) -> ModelCard:
    test = data.role == Role.TEST
    everything = measures(data, predicted, test)
    enabled = measures(data, predicted, test & data.enabled)
    used = [sum(s.stop - s.start for s in data.segments if s.recording == i)
            for i in range(len(data.recordings))]  # fmt: skip
    return ModelCard(
        kind="narx",
        inputs=data.inputs,
        output=data.output,
        transform=data.transform,
        output_limits=(data.scaling.y_low, data.scaling.y_high),
        period_ns=data.period_ns,
        lags=network.spec.lags,
        input_lag_start=network.spec.input_lag_start,
        layers=network.spec.hidden,
        state=network.state_layout,
        recordings=tuple(
            TrainingRecording(
                Path(r.path).name, r.sha256, n, source_of(Path(r.path), r.sha256) or ""
            )
            for r, n in zip(data.recordings, used, strict=True)
        ),
        residual_mean=enabled.get("residual_mean", 0.0),
        residual_std=enabled.get("residual_std", everything.get("residual_std", 0.0)),
        transforms=data.transforms,
        fit={"test": everything, "test_enabled": enabled},
        checks=dict(checks),
        packages={name: version(name) for name in ("numpy", "onnx", "onnxruntime", "scipy")},
    )
