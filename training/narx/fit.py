"""Fit a NARX to recordings: prepare, search by folds, train on with all samples, write the file."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import BoolArray
from training.narx.cross_fit import CrossFit, cross_fit
from training.narx.export import Network
from training.narx.model_file import FreeRunFit, held_out, write_model
from training.narx.network import Spec
from training.narx.search.folds import FOLDS, fold, groups_of, withheld
from training.narx.search.mean import NetworkChoice, choose
from training.narx.search.structure import GivenShape, Search, Try
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role, prepare

if TYPE_CHECKING:
    from training.recordings.recording import Recording

LAGS, HIDDEN = 5, (8, 8)  # of the paper's network
STARTS = 3  # of a shape that is given
PARTS = 2  # the search has half of the work, its best trainings half of the rest with their folds
ENDED_EARLY = "the wall limit ended the training early: it would end elsewhere on another machine"
SAMPLES_PER_WEIGHT = 10  # with fewer the network overfits


@dataclass(frozen=True, slots=True, kw_only=True)
class FitResult(FreeRunFit):
    """The model, its data and its trainings."""

    network: Network
    chosen: NetworkChoice
    unseen: CrossFit  # free runs of twins over what they did not see
    tries: tuple[Try, ...]  # structures that were tried, none if the shape was given


@dataclass(frozen=True, slots=True, kw_only=True)
class FitOptions:
    """How a network is trained."""

    lags: int | None = None  # with ``hidden`` the shape; if neither is given, a search chooses
    hidden: tuple[int, ...] | None = None  # neurons per layer
    input_lag_start: int = 1  # 0 lets the inputs of the predicted tick in
    starts: int | None = None  # trainings from different random weights; default 3 of a given
    # shape, of which the best is the model, and 4 of a search, whose mean is
    budget_minutes: float = 10.0  # of work that one core does in about this time
    wall_minutes: float | None = None  # after which no further epoch begins
    seed: int = 0
    threads: int = 2
    keep_validation: bool = False  # never train on the validation blocks
    progress: Callable[[float], None] = lambda _: None  # takes the work of every epoch
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
    validate: "Sequence[Recording]" = ()  # choose the network, not trained on; without them each
    # recording does in turn
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
    8). Trainings that left out a fold each are trained on with all samples that the limits do not
    need; without these folds they are the model's twins.
    Raises RecordingError or UsageError if the recordings or names cannot be used.
    """
    options, began_s = options or FitOptions(), time.monotonic()
    work = Work.of_minutes(options.budget_minutes, options.wall_minutes, options.progress)
    data, given, warnings = source.prepared(options.lags or LAGS, options.seed), None, list[str]()
    if options.lags is not None or options.hidden is not None:
        size = options.lags or LAGS, options.hidden or HIDDEN
        given = GivenShape(*size, options.input_lag_start)
        warnings = _size_warnings(data, given.spec(data))
    parts = _parts(data, options, chooses=bool(source.validate))
    starts = options.starts or (STARTS if given else FOLDS)
    search = Search(parts.folds, options.seed, options.threads, options.tried, given, starts)
    for part, use in ((PARTS, search.run), (PARTS - 1, search.train_members)):
        own = work.up_to(work.left / part)
        use(own)
        work.join([own])
    members = search.refitted(parts.everything, work, starts)
    chosen = choose(parts.everything, members, options.seed, work, join=given is None)
    if not np.isfinite(chosen.model.score):
        raise UsageError(
            f"the budget of {options.budget_minutes:g} min ended before the first epoch"
        )
    if given is None:
        warnings = _size_warnings(data, chosen.best_member.spec)
    twins = cross_fit(data, parts.folds, search.members)
    reported = replace(data, role=parts.role)
    unseen = np.where(parts.trained_test, twins.predicted, np.nan)
    network, card, run = write_model(
        out, reported, chosen.model, chosen.gap, work=work, twins=twins.to_card(), unseen=unseen
    )
    return FitResult(
        path=Path(out),
        card=card,
        network=network,
        data=reported,
        chosen=chosen,
        predicted=run,
        held_out=held_out(reported),
        unseen=twins,
        tries=() if given else tuple(search.ranked),
        seconds=time.monotonic() - began_s,
        warnings=(
            *data.warnings,
            *warnings,
            *_training_warnings(chosen, data.memory),
            *([ENDED_EARLY] if work.ended_by_wall else []),
        ),
    )


@dataclass(frozen=True, slots=True)
class _Parts:
    """The samples of the search's trainings, and of the model."""

    folds: tuple[Prepared, ...]
    everything: Prepared
    role: np.ndarray  # (n,) Role of each sample in the end
    trained_test: BoolArray  # (n,) test samples that the model saw and its twins did not


def _parts(data: Prepared, options: FitOptions, *, chooses: bool) -> _Parts:
    """Return the parts of the data.

    chooses : recordings were given that choose, and are not trained on
    """
    validate, test = data.role == Role.VALIDATE, data.role == Role.TEST
    kept = validate | test if options.keep_validation else withheld(data)
    if chooses:
        folds = [everything := fold(data, kept & test, validate)]
    else:
        groups = [rows for rows in groups_of(data) if data.samples.weight[rows & ~kept].any()]
        folds = [fold(data, kept, rows) for rows in groups]
        everything = fold(data, kept, np.zeros_like(kept))
    seen = (everything.role == Role.TRAIN) & ~kept
    role = np.where(validate & seen, Role.TRAIN, data.role).astype(data.role.dtype)
    return _Parts(tuple(folds), everything, role, test & seen)


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


def _training_warnings(chosen: NetworkChoice, memory: int) -> list[str]:
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
