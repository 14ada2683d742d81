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

from monitor.base.errors import RecordingError, UsageError
from monitor.base.manifest import source_of
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard, TrainingRecording
from monitor.model.step import from_model_units
from training.narx.committee import committee
from training.narx.export import Network, save
from training.narx.network import Spec
from training.narx.parity import parity
from training.narx.stability import CONTRACTION_SAMPLES, Contraction, contraction
from training.narx.stages import Trained, free_run, free_run_score, train
from training.narx.structure import LEAST_GAIN, Search, Structure, Try
from training.recordings import metrics
from training.recordings.preparation import Prepared, Role, prepare

if TYPE_CHECKING:
    from training.recordings.recording import Recording

PARITY_SAMPLES = 3000
SEARCH_SHARE = 0.4  # of the budget goes into the choice of memory and size
SHORT_SAMPLES, ROTATIONS = 5000, 4  # shorter recordings choose by several sets of held-out blocks
MOST_MEMBERS = 3  # of a committee
STARTS, STARTS_SHORT = 3, 8  # trainings from other random weights
FURTHER_STARTS = 3  # at most, where none of them forgets how it began
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
    best: int  # which start, or committee of starts
    predicted: FloatArray  # (n,) free run over data.samples in model units, NaN at the beginnings
    held_out: tuple[HeldOut, ...]
    tries: tuple[Try, ...]  # structures that the data chose from, none if the shape was given
    seconds: float
    warnings: tuple[str, ...]


def fit(
    recordings: "Sequence[Recording]",
    inputs: Sequence[str],
    output: str,
    out: Path | str,
    *,
    lags: int | None = None,
    hidden: tuple[int, ...] | None = None,
    input_lag_start: int = 1,
    transforms: Sequence[Mapping[str, Any]] = (),
    starts: int | None = None,
    budget_minutes: float = 10.0,
    seed: int = 0,
    threads: int = 2,
    validate: Sequence["Recording"] = (),
    progress: Callable[[int, int, int, float], None] | None = None,
    tried: Callable[[Try], None] | None = None,
) -> FitResult:
    """Train on ``recordings`` and write the model file ``out``.

    lags, hidden : shape of the NARX; if neither is given memory and size are chosen by the data,
        inputs of the tick itself enter and a linear path is added; if only one is given the other
        is the paper's (5; 8, 8)
    validate : recordings that choose and stop and are not trained on; without, held-out blocks do
    starts : trainings from other random weights, default 3, on short recordings 8; up to
        three more while none of them forgets how it began and there is time
    transforms : of inputs, see ``training.recordings.transforms``
    progress : called with start, horizon, epoch and best validation RMSE after every epoch
    tried : called after every structure that was tried
    Raises RecordingError or UsageError if the recordings or names cannot be used.
    """
    if starts is not None and starts < 1:
        raise UsageError(f"starts {starts}: must be at least 1")
    began = time.monotonic()
    everything = (*recordings, *validate)
    judges = range(len(recordings), len(everything))

    def prepared(seed: int) -> Prepared:
        return prepare(
            everything, inputs, output, transforms, lags=lags or 5, seed=seed, validate=judges
        )

    data = prepared(seed)
    tries: tuple[Try, ...] = ()
    shapes = [
        (
            Spec(
                len(inputs),
                lags or 5,
                hidden or (8, 8),
                input_lag_start,
                *data.scaling.y_scaled_limits,
            ),
            0.0,
        )
    ]
    if lags is None and hidden is None:
        chosen, tries = _search(data, prepared, seed, began, budget_minutes, threads, tried)
        shapes = [(structure.spec(data), structure.decay) for structure in chosen]
    warnings = [*data.warnings, *_size_warnings(data, shapes[0][0])]
    if starts is None:
        starts = STARTS_SHORT if len(data.role) < SHORT_SAMPLES else STARTS
    jobs = [(index, *shape) for shape in shapes for index in range(starts)]
    deadline_s = began + 60.0 * budget_minutes
    trained = _train_all(data, jobs, seed, deadline_s, threads, progress)
    trained = (*trained, *committees(data, trained)) if tries else trained
    trained, best, gap = _until_one_forgets(
        data, trained, shapes[0], starts, seed, deadline_s, progress
    )
    if not np.isfinite(trained[best].score):
        raise UsageError(f"the budget of {budget_minutes:g} min ended before the first epoch")
    warnings += _training_warnings(trained, gap, data.must_forget)
    spec, weights = trained[best].spec, trained[best].weights
    predicted = data.scaling.unscale_y(free_run(data, spec, weights))
    network, card = write_model(out, data, spec, weights, predicted, gap, trained[best].members)
    warnings += _parity_warnings(card)
    return FitResult(
        Path(out),
        card,
        network,
        data,
        trained,
        best,
        predicted,
        held_out(data),
        tries,
        time.monotonic() - began,
        tuple(warnings),
    )


def _train_all(
    data: Prepared,
    jobs: Sequence[tuple[int, Spec, float]],
    seed: int,
    deadline_s: float,
    threads: int,
    progress: Callable[[int, int, int, float], None] | None,
) -> tuple[Trained, ...]:
    """Train every start, shape and decay; each round gets its part of the time left."""
    workers = max(1, min(threads, len(jobs)))
    rounds = -(-len(jobs) // workers)
    begun = time.monotonic()

    def one(number: int) -> Trained:
        start, spec, decay = jobs[number]
        told = (lambda h, e, s: progress(number, h, e, s)) if progress else None
        until_s = begun + (number // workers + 1) / rounds * (deadline_s - begun)
        return train(data, spec, seed + 1000 * start, until_s, told, decay=decay)

    with ThreadPoolExecutor(workers) as pool:
        return tuple(pool.map(one, range(len(jobs))))


def _until_one_forgets(
    data: Prepared,
    trained: tuple[Trained, ...],
    shape: tuple[Spec, float],
    starts: int,
    seed: int,
    deadline_s: float,
    progress: Callable[[int, int, int, float], None] | None,
) -> tuple[tuple[Trained, ...], int, Contraction]:
    """Return the trainings with what further starts it took, and ``choose`` of them.

    A start is begun only if there is as much time left as the first one took.
    """

    def told(_: int, *reached: Any) -> None:
        if progress:
            progress(len(trained), *reached)

    latest_s = deadline_s - sum(stage.seconds for stage in trained[0].stages)
    best, gap = choose(data, trained, seed)
    for start in range(starts, starts + FURTHER_STARTS):
        if not data.must_forget or gap.gap <= gap.limit or time.monotonic() > latest_s:
            break
        trained += _train_all(data, [(start, *shape)], seed, deadline_s, 1, told)
        best, gap = choose(data, trained, seed)
    return trained, best, gap


def write_model(
    out: Path | str,
    data: Prepared,
    spec: Spec,
    weights: FloatArray,
    predicted: FloatArray,
    gap: Contraction,
    members: int = 1,
) -> tuple[Network, ModelCard]:
    """Write trained weights as a model file, its parity proved; return what stands in it.

    predicted : (n,) free run over ``data.samples`` in model units, for the card's measures
    members : trainings whose mean it is, for the card
    Raises ModelError if ONNX, torch and numpy disagree.
    """
    network = Network(spec, weights, data.scaling, data.transform, data.transforms, data.names)
    checks: dict[str, Any] = {
        "contraction": {
            "gap": gap.gap,
            "samples": CONTRACTION_SAMPLES,
            "pairs": gap.pairs,
            "limit": gap.limit,
        },
    }
    save(out, network, _card(data, network, predicted, checks, members))
    checks["parity"] = _parity(out, network, data)
    card = _card(data, network, predicted, checks, members)
    save(out, network, card)
    return network, card


def _search(
    data: Prepared,
    prepared: Callable[[int], Prepared],
    seed: int,
    began_s: float,
    budget_minutes: float,
    threads: int,
    tried: Callable[[Try], None] | None,
) -> tuple[list[Structure], tuple[Try, ...]]:
    """Return the structures that suit the data, best first, within their share of the budget."""
    short = len(data.role) < SHORT_SAMPLES
    others = [prepared(seed + i) for i in range(1, ROTATIONS)] if short else []
    deadline_s = began_s + SEARCH_SHARE * 60.0 * budget_minutes
    search = Search([data, *others], deadline_s, threads, tried)
    return search.run(), tuple(search.tries.values())


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
    """Return the recordings for a card, with the samples that each of them gave."""
    used = [
        sum(s.stop - s.start for s in data.segments if s.recording == i)
        for i in range(len(data.recordings))
    ]
    return tuple(
        TrainingRecording(Path(r.path).name, r.sha256, n, source_of(Path(r.path), r.sha256) or "")
        for r, n in zip(data.recordings, used, strict=True)
    )


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


def committees(data: Prepared, trained: Sequence[Trained]) -> list[Trained]:
    """Return the means of the two, three ... best trainings of each shape.

    The score of a committee is raised by what a larger model must be better.
    """
    found = []
    for spec in dict.fromkeys(t.spec for t in trained):
        same = [t for t in trained if t.spec == spec and np.isfinite(t.score)]
        same.sort(key=lambda t: t.score)
        for count in range(2, min(len(same), MOST_MEMBERS) + 1):
            wide, weights = committee(spec, [t.weights for t in same[:count]])
            score = free_run_score(data, wide, weights)
            found.append(Trained(wide, weights, score / (1 - LEAST_GAIN), members=count))
    return found


def choose(data: Prepared, trained: Sequence[Trained], seed: int) -> tuple[int, Contraction]:
    """Return the best start; a lambda that forgets its history comes before one that does not."""
    gaps = [contraction(data, t.spec, t.weights, seed) for t in trained]
    best = min(
        range(len(trained)),
        key=lambda i: (data.must_forget and not gaps[i].gap <= gaps[i].limit, trained[i].score),
    )
    return best, gaps[best]


def _parity_warnings(card: ModelCard) -> list[str]:
    found = card.checks["parity"]
    if found["onnx_numpy"] <= found["tolerance"]:
        return []
    return [
        f"the model file's float32 rounding adds up to {found['onnx_numpy']:.2g} over "
        f"{found['samples']} samples of free run: the output integrates"
    ]


def _training_warnings(
    trained: Sequence[Trained], gap: Contraction, must_forget: bool
) -> list[str]:
    warnings = []
    if must_forget and not gap.gap <= gap.limit:
        warnings.append(
            f"predictions from two histories differ by up to {gap.gap:.3g} after "
            f"{CONTRACTION_SAMPLES} samples (limit {gap.limit:.3g})"
        )
    begun = [t for t in trained if t.members == 1]
    cut = sum(t.stages[-1].stop == "budget" if t.stages else True for t in begun)
    if cut:
        warnings.append(f"the budget ended {cut} of {len(begun)} starts before their last stage")
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
    return {
        "samples": result.samples,
        "onnx_numpy": result.onnx_numpy,
        "torch_numpy": result.torch_numpy,
        "tolerance": result.tolerance,
    }


def _card(
    data: Prepared,
    network: Network,
    predicted: FloatArray,
    checks: Mapping[str, Any],
    members: int,
) -> ModelCard:
    test = data.role == Role.TEST
    everything = measures(data, predicted, test)
    enabled = measures(data, predicted, test & data.enabled)
    return ModelCard(
        kind="narx",
        inputs=data.inputs,
        output=data.output,
        transform=data.transform,
        output_limits=(data.scaling.y_low, data.scaling.y_high),
        period_ns=data.period_ns,
        lags=network.spec.memory,
        input_lag_start=network.spec.boxes[0][0],
        layers=network.spec.hidden,
        state=network.state_layout,
        recordings=recordings_of(data),
        residual_mean=enabled.get("residual_mean", 0.0),
        residual_std=enabled.get("residual_std", everything.get("residual_std", 0.0)),
        transforms=data.transforms,
        structure={
            "input_boxes": [list(box) for box in network.spec.boxes],
            "output_lags": network.spec.lags,
            "linear_path": network.spec.linear_path,
            "members": members,
        },
        fit={"test": everything, "test_enabled": enabled},
        checks=dict(checks),
        packages={name: version(name) for name in ("numpy", "onnx", "onnxruntime", "scipy")},
    )
