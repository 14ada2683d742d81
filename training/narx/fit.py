"""Fit a NARX to recordings: prepare, choose a structure, train several starts, write the file."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.narx import model_file
from training.narx.cross_fit import CrossFit, cross_fit
from training.narx.export import build, write
from training.narx.model_file import FreeRunFit, Unseen
from training.narx.network import Spec
from training.narx.search.mean import NetworkChoice, choose
from training.narx.search.stability import Contraction
from training.narx.search.stages import N_SAMPLES, Trained, train
from training.narx.search.structure import FOLDS, STARTS, Search, Try, folds_of
from training.narx.work import Work
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, prepare

LAGS, HIDDEN = 5, (8, 8)  # of the paper's network
PARTS = 3  # of equal work: the search, the members of its mean, the twins
ENDED_EARLY = "the wall limit ended the training early: it would end elsewhere on another machine"
SAMPLES_PER_WEIGHT = 10  # with fewer the network overfits


@dataclass(frozen=True, slots=True, kw_only=True)
class FitResult(FreeRunFit):
    """The model, its data and its trainings."""

    chosen: NetworkChoice
    unseen: CrossFit  # free runs of twins over what they did not see
    tries: tuple[Try, ...]  # structures that were tried, none if the shape was given

    def healthy(self) -> tuple[Unseen, str]:
        """Return the twins, each with the drives that it has not seen; without any, the model."""
        if self.unseen.twins:
            return list(self.unseen.unseen(self.card)), model_file.OF_TWINS
        return [(Model.load(self.path), self.data.recordings)], model_file.ALL_OF_A_NETWORK


@dataclass(frozen=True, slots=True, kw_only=True)
class FitOptions:
    """How a network is trained."""

    lags: int | None = None  # with ``hidden`` the shape; if neither is given, a search chooses
    hidden: tuple[int, ...] | None = None  # neurons per layer
    input_lag_start: int = 1  # 0 lets the inputs of the predicted tick in
    starts: int | None = None  # default 3 of a given shape for the best, 4 of a search for a mean
    budget_minutes: float = 10.0  # of work that one core does in about this time
    wall_minutes: float | None = None  # after which no further epoch begins
    seed: int = 0
    threads: int = 2
    keep_held_out: bool = False  # never train on the blocks that choose, nor on those of the test
    progress: Callable[[float], None] = lambda _: None  # takes the work of every epoch
    tried: Callable[[Try], None] | None = None  # takes every structure of the search

    def __post_init__(self) -> None:
        counts = [("lags", self.lags, 1), ("starts", self.starts, 1), ("seed", self.seed, 0)]
        for name, value, least in (*counts, *(("hidden", n, 1) for n in self.hidden or ())):
            if value is not None and value < least:
                raise UsageError(f"{name} {value}: {least} or more is wanted")
        for name, minutes in (("budget", self.budget_minutes), ("wall", self.wall_minutes)):
            if minutes is not None and not 0.0 < minutes < np.inf:
                raise UsageError(f"{name} {minutes:g}: wanted are minutes, more than 0")


@dataclass(frozen=True, slots=True)
class FitSource:
    """Recordings and signals of a fit, to be prepared with several sets of held-out blocks."""

    recordings: Sequence[Recording]
    inputs: Sequence[str]
    output: str

    def prepared(self, lags: int, seed: int) -> Prepared:
        """Return the data; ``seed`` chooses the held-out blocks."""
        source = (self.recordings, self.inputs, self.output)
        return prepare(*source, lags=lags, seed=seed, turn_fuel=True)


def fit(source: FitSource, out: Path | str, options: FitOptions | None = None) -> FitResult:
    """Train on the source's recordings and write the model file ``out``.

    If neither lags nor layers are given, a search chooses memory and size, inputs of the tick
    itself enter and a linear path is added; if one is given, the other one is the paper's (5; 8,
    8). Trainings of short recordings take turns over the validation blocks, unless these are kept
    for a comparison with other models.
    Raises RecordingError or UsageError if the recordings or names cannot be used.
    """
    began_s, options = time.monotonic(), options or FitOptions()
    seed, threads = options.seed, options.threads
    whole = Work.of_minutes(options.budget_minutes, options.wall_minutes, options.progress)
    work = whole.up_to(whole.limit * (PARTS - 1) / PARTS)
    data = source.prepared(options.lags or LAGS, seed)
    seen = data if options.keep_held_out else data.training_on(Role.TEST)
    if options.lags is None and options.hidden is None:
        chosen, tries = _searched(source, seen, options, work)
    else:
        chosen, tries = _trained(seen, options, work), ()
    whole.join(work)
    few = _size_warnings(seen, chosen.best_member.spec)
    warnings = (*data.warnings, *few, *_training_warnings(chosen, data.memory, whole))
    if not np.isfinite(chosen.model.score):
        limit = "wall limit" if whole.ended_by_wall else f"budget of {options.budget_minutes:g} min"
        raise UsageError(f"the {limit} ended before the first epoch")
    model, best = chosen.model, chosen.best_member
    twins = cross_fit(data, best.spec, decay=best.decay, seed=seed, work=whole, threads=threads)
    return FitResult(
        path=Path(out),
        card=write_model(out, model.spec, model.weights, twins, chosen.gap, model.members, whole),
        data=twins.data,
        chosen=chosen,
        predicted=twins.predicted,
        unseen=twins,
        tries=tries,
        seconds=time.monotonic() - began_s,
        warnings=(*warnings, *([ENDED_EARLY] if whole.ended_by_wall else [])),
    )


def write_model(
    out: Path | str,
    spec: Spec,
    weights: FloatArray,
    twins: CrossFit,
    gap: Contraction,
    members: int = 1,
    work: Work | None = None,
) -> ModelCard:
    """Write a network as a model file; return its card with the measures of its twins.

    members : trainings of which the network is the mean
    work : of the training, for the card
    """
    checks: dict[str, Any] = {"contraction": asdict(gap)}
    if work:
        checks["work"] = {"counted": work.spent, "ended_by_wall": work.ended_by_wall}
    network = model_file.network_of(twins.data, spec, weights)
    own = {"unseen": twins.to_card(), "checks": checks, **model_file.shape_of(network, members)}
    card = model_file.card_of(twins.data, twins.predicted, kind="narx", **own)
    write(out, build(network), card)
    return card


def _searched(
    source: FitSource, data: Prepared, options: FitOptions, work: Work
) -> tuple[NetworkChoice, tuple[Try, ...]]:
    """Return the mean of the best trainings, and all tries."""
    seed, n_train = options.seed, int((data.role == Role.TRAIN).sum())
    count = min(max(N_SAMPLES // n_train, 1), FOLDS)
    folds = folds_of(data, (source.prepared(LAGS, seed + i) for i in range(1, FOLDS)))
    searching = work.up_to(work.limit / (PARTS - 1))
    search = Search(folds, count, seed, searching, options.threads, options.tried)
    search.run()
    work.join(searching)
    members = search.members(options.keep_held_out, work, options.starts or FOLDS)
    return choose(data, members, seed, work, join=True), tuple(search.ranked)


def _trained(data: Prepared, options: FitOptions, work: Work) -> NetworkChoice:
    """Return the best of several starts of the shape that was asked for."""
    size = options.lags or LAGS, options.hidden or HIDDEN
    spec = Spec(len(data.inputs), *size, options.input_lag_start, *data.scaling.y_scaled_limits)
    _size_warnings(data, spec)
    starts = [Trained(spec, seed=options.seed + 1000 * i) for i in range(options.starts or STARTS)]
    found = work.side_by_side(partial(train, data), starts, options.threads)
    return choose(data, found, options.seed, work, join=False)


def _size_warnings(data: Prepared, spec: Spec) -> list[str]:
    n = data.n_train
    if n < spec.n_weights:
        raise RecordingError(
            f"{n} training samples for {spec.n_weights} weights are too few: "
            "record more or use a smaller model (--hidden, --lags)"
        )
    if n < SAMPLES_PER_WEIGHT * spec.n_weights:
        return [f"{n} training samples for {spec.n_weights} weights: expect overfitting"]
    return []


def _training_warnings(chosen: NetworkChoice, memory: int, work: Work) -> list[str]:
    warnings = chosen.gap.warnings() if memory else []
    begun = [t for t in chosen.starts if t.members == 1]
    limit = "wall limit" if work.ended_by_wall else "budget"
    if cut := sum(t.cut_short for t in begun):
        warnings.append(f"the {limit} ended {cut} of {len(begun)} starts before their last stage")
    return warnings
