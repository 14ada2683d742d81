"""Fit a NARX to recordings: prepare, choose a structure, train several starts, write the file."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from training.narx.cross_fit import CrossFit, cross_fit
from training.narx.export import Network
from training.narx.linear.arx import Arx
from training.narx.model_file import HeldOut, held_out, write_model
from training.narx.network import Spec
from training.narx.search.folds import folds_of, free_folds, trained_on_all
from training.narx.search.linear_start import best_arx, linear_starts, with_memory
from training.narx.search.stability import Contraction
from training.narx.search.stages import Trained, free_run
from training.narx.search.starts import Shape, Starts, committees, means
from training.narx.search.structure import Search, Try
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role, prepare

if TYPE_CHECKING:
    from training.recordings.recording import Recording

LAGS, HIDDEN = 5, (8, 8)  # of the paper's network
SEARCH_SHARE = 0.4  # of the budget goes into the choice of memory and size
CROSS_FIT_SHARE = 0.5  # of the work is that of the twins
SHORT_SAMPLES, ROTATIONS = 5000, 4  # shorter recordings choose by several sets of held-out blocks
STARTS, STARTS_SHORT = 3, 8  # trainings from different random weights
ENDED_EARLY = "the wall limit ended the training early: it would end elsewhere on another machine"
SAMPLES_PER_WEIGHT = 10  # with fewer the network overfits


@dataclass(frozen=True, slots=True)
class FitResult:
    """The model, its data and its trainings."""

    path: Path
    card: ModelCard
    network: Network
    data: Prepared
    starts: tuple[Trained, ...]
    best: int  # number of the training that is the model
    predicted: FloatArray  # (n,) free run over data.samples in model units, NaN at the beginnings
    held_out: tuple[HeldOut, ...]
    unseen: CrossFit  # free runs of twins over what they did not see
    tries: tuple[Try, ...]  # structures that were tried, none if the shape was given
    seconds: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FitOptions:
    """How a network is trained."""

    lags: int | None = None  # with ``hidden`` the shape; if neither is given, a search chooses
    hidden: tuple[int, ...] | None = None  # neurons per layer
    input_lag_start: int = 1  # 0 lets the inputs of the predicted tick in
    starts: int | None = None  # trainings from different random weights, default 3; see ``fit``
    budget_minutes: float = 10.0  # of work that one core does in about this time
    wall_minutes: float | None = None  # after which no further epoch begins
    seed: int = 0
    threads: int = 2
    keep_validation: bool = False  # never train on the validation blocks
    progress: Callable[[int, int, int, float], None] | None = None  # takes start, horizon, epoch
    # and best validation RMSE after every epoch
    tried: Callable[[Try], None] | None = None  # takes every structure of the search

    def __post_init__(self) -> None:
        if self.starts is not None and self.starts < 1:
            raise UsageError(f"starts {self.starts}: must be at least 1")


@dataclass(frozen=True, slots=True)
class FitSource:
    """Recordings and signals of a fit, to be prepared with several sets of held-out blocks."""

    recordings: "Sequence[Recording]"
    inputs: Sequence[str]
    output: str
    validate: "Sequence[Recording]" = ()  # choose and stop the training, not trained on; without
    # them held-out blocks do
    transforms: Sequence[Mapping[str, Any]] = ()  # of inputs, see ``recordings.transforms``

    def prepared(self, lags: int, seed: int) -> Prepared:
        """Return the data; ``seed`` chooses the held-out blocks."""
        everything = (*self.recordings, *self.validate)
        return prepare(
            everything,
            self.inputs,
            self.output,
            self.transforms,
            lags=lags,
            seed=seed,
            validate=range(len(self.recordings), len(everything)),
            turn_fuel=True,
        )


def fit(source: FitSource, out: Path | str, options: FitOptions | None = None) -> FitResult:
    """Train on the source's recordings and write the model file ``out``.

    If neither lags nor layers are given, a search chooses memory and size, inputs of the tick
    itself enter and a linear path is added; if one is given, the other one is the paper's (5; 8,
    8). A short recording has 8 starts, and trains on its validation blocks in the end unless these
    are kept for a comparison with other models; up to three more starts are made while none of
    them forgets how it began and there is time.
    Raises RecordingError or UsageError if the recordings or names cannot be used.
    """
    options = options or FitOptions()
    seed, threads = options.seed, options.threads
    began_s = time.monotonic()
    lags = options.lags or LAGS
    data = source.prepared(lags, seed)
    short = len(data.role) < SHORT_SAMPLES
    whole = Work.of_minutes(options.budget_minutes, options.wall_minutes)
    work = whole.up_to((1.0 - CROSS_FIT_SHARE) * whole.limit)
    shapes, tries = [_shape(data, options)], tuple[Try, ...]()
    arx, folds = None, [data]
    if options.lags is None and options.hidden is None:
        if arx := best_arx(data):
            data = with_memory(data, arx)
        others = (source.prepared(lags, seed + i) for i in range(1, ROTATIONS if short else 1))
        rotations = folds_of(data, others)
        keep = source.validate or options.keep_validation
        folds = rotations[:1] if keep else free_folds(rotations)
        searching = work.up_to(SEARCH_SHARE * whole.limit)
        search = Search(rotations, searching, threads, options.tried)
        shapes = [(found.spec(data), found.decay) for found in search.run()]
        work.join([searching])
        tries = tuple(search.tries.values())
    warnings = [*data.warnings, *_size_warnings(data, shapes[0][0])]
    count = options.starts or (STARTS_SHORT if short else STARTS)
    runs = Starts(folds[:count], seed, work, threads, options.progress)
    chosen = _train(runs, shapes, count, arx, join=bool(tries))
    if not np.isfinite(chosen.model.score):
        raise UsageError(
            f"the budget of {options.budget_minutes:g} min ended before the first epoch"
        )
    if len(runs.folds) > 1 and chosen.model.spec.hidden:
        data = trained_on_all(data)
    whole.join([work])
    spare = whole.up_to(CROSS_FIT_SHARE / (1.0 - CROSS_FIT_SHARE) * work.spent)
    twins = cross_fit(
        data,
        _member(chosen.model),
        decay=chosen.model.decay,
        seed=seed,
        work=spare,
        threads=threads,
    )
    whole.join([spare])
    written = _write(out, data, chosen, twins, whole)
    return FitResult(
        path=Path(out),
        card=written.card,
        network=written.network,
        data=data,
        starts=chosen.starts,
        best=chosen.best,
        predicted=written.predicted,
        held_out=held_out(data),
        unseen=twins,
        tries=tries,
        seconds=time.monotonic() - began_s,
        warnings=(
            *warnings,
            *_training_warnings(chosen, data.memory),
            *([ENDED_EARLY] if whole.ended_by_wall else []),
            *_parity_warnings(written.card),
        ),
    )


def _shape(data: Prepared, options: FitOptions) -> Shape:
    """Return the shape that was asked for, the paper's where nothing was said."""
    limits = data.scaling.y_scaled_limits
    size = options.lags or LAGS, options.hidden or HIDDEN
    return Spec(len(data.inputs), *size, options.input_lag_start, *limits), 0.0


@dataclass(frozen=True, slots=True)
class _Choice:
    """All trainings, the number of the best one, and how well it forgets its history."""

    starts: tuple[Trained, ...]
    best: int
    gap: Contraction

    @property
    def model(self) -> Trained:
        """Return the training that is the model."""
        return self.starts[self.best]


def _train(
    runs: Starts, shapes: Sequence[Shape], count: int, arx: Arx | None, *, join: bool
) -> _Choice:
    """Train every shape from ``count`` starts.

    arx : linear model, which is a candidate, as it is and trained further
    join : committees of the starts are candidates
    """
    linear = linear_starts(runs.folds, arx, runs.work) if arx else ()
    trained = runs.train([(start, shape) for shape in shapes for start in range(count)])
    if join:
        several = len(runs.folds) > 1
        trained += (
            means(runs.folds, trained, runs.seed) if several else committees(runs.data, trained)
        )
    trained += linear
    return _Choice(*runs.until_one_forgets(trained, shapes[0], first=count))


@dataclass(frozen=True, slots=True)
class _Written:
    """The model file's card and network, and their free run."""

    card: ModelCard
    network: Network
    predicted: FloatArray  # (n,) in model units


def _member(model: Trained) -> Spec:
    """Return the shape of one of the trainings whose mean the model is."""
    return replace(model.spec, hidden=tuple(n // model.members for n in model.spec.hidden))


def _write(
    out: Path | str, data: Prepared, chosen: _Choice, twins: CrossFit, work: Work
) -> _Written:
    model = chosen.model
    predicted = data.scaling.unscale_y(free_run(data, model.spec, model.weights))
    network, card = write_model(
        out,
        data,
        spec=model.spec,
        weights=model.weights,
        predicted=predicted,
        gap=chosen.gap,
        members=model.members,
        unseen=twins.to_card(),
        work=work,
    )
    return _Written(card, network, predicted)


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


def _training_warnings(chosen: _Choice, memory: int) -> list[str]:
    gap, warnings = chosen.gap, []
    if memory and not gap.gap <= gap.limit:
        warnings.append(
            f"two runs that begin with different past values differ by up to {gap.gap:.3g} after "
            f"{gap.samples} samples (limit {gap.limit:.3g})"
        )
    begun = [t for t in chosen.starts if t.members == 1]
    cut = sum(t.stages[-1].stop == "budget" if t.stages else True for t in begun)
    if cut:
        warnings.append(f"the budget ended {cut} of {len(begun)} starts before their last stage")
    return warnings


def _parity_warnings(card: ModelCard) -> list[str]:
    found = card.checks["parity"]
    if found["onnx_numpy"] <= found["tolerance"]:
        return []
    return [
        f"the model file's float32 rounding adds up to {found['onnx_numpy']:.2g} over "
        f"{found['samples']} samples of free run: the output integrates"
    ]
