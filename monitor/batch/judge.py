"""Whole recordings side by side, with the same results as ``pipeline.Monitor``.

Conditions and plausibility of a recording are judged as arrays. Every run of samples with valid
inputs is a segment, begun like the streaming monitor begins; segments of many recordings are rows
that model and bank step together. Decisions are the monitor's own. A property test holds the two
together, bit for bit.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor import enable, hypotheses
from monitor.batch.bank import BankBlock, phases
from monitor.config import Config
from monitor.decide import Change, Decisions, DtcChanged, WindowJudged
from monitor.dtc import Dtc, DtcStore
from monitor.enable import Enable
from monitor.limits import Limits
from monitor.model import Model
from monitor.pipeline import BURNING, check_names
from monitor.plausibility import ActivityTest, Plausibility, TickResult, TickResults
from monitor.reference import Reference, Seen
from monitor.runs import runs, since, stretches
from monitor.types import BoolArray, FloatArray, IntArray, SampleBlock
from monitor.window import Window

_INPUTS_VALID = enable.CONDITIONS.index("inputs_valid")

# sample, place within the sample, and what then is decided
Result = tuple[int, int, Callable[[], Iterable[WindowJudged | Change]]]


@dataclass(frozen=True, slots=True)
class Judged:
    """What the monitor makes of one recording."""

    measured: FloatArray  # (n,) output's unit
    predicted: FloatArray  # (n,) output's unit, NaN while an input is not valid
    conditions: BoolArray  # (n, n_conditions) in the order of enable.CONDITIONS
    enabled: BoolArray  # (n,)
    windows: list[WindowJudged]
    changes: list[DtcChanged]
    dtcs: list[Dtc]  # pending or confirmed at the end
    completed: bool  # the response test reached a decision
    seen: Seen | None  # what the vehicle's reference may learn


class Segment(NamedTuple):
    """A run of samples with valid inputs."""

    recording: int
    begin: int
    end: int

    @property
    def length(self) -> int:
        """Return the number of samples."""
        return self.end - self.begin


def judge_all(
    blocks: Sequence[SampleBlock],
    names: Sequence[str],
    model: Model,
    limits: Limits,
    config: Config,
    stores: Sequence[DtcStore] | None = None,
    references: Sequence[Reference] | None = None,
    rows: int = 64,
) -> list[Judged]:
    """Return the verdicts on recordings, in their order.

    names : what each sample holds; must contain the model's inputs and output
    stores : fault memory of each recording, in which its driving cycle has begun; by default empty
    references : of each recording's vehicle; by default nothing is known of it
    rows : how many recordings, and how many segments of theirs, run side by side
    Raises RecordingError if a signal the model needs is not among ``names``. A window keeps what
    the bank read in it, a drive of half an hour some megabytes.
    """
    check_names(model.card, names)
    if stores is None:
        stores = [DtcStore() for _ in blocks]
        for store in stores:
            store.start_driving_cycle()
    own = [
        limits.of_vehicle(each, config.bias) for each in references or [Reference()] * len(blocks)
    ]
    judged: dict[int, Judged] = {}
    order = sorted(range(len(blocks)), key=lambda i: len(blocks[i].t_ns))  # alike side by side
    for first in range(0, len(order), rows):
        chosen = order[first : first + rows]
        batch = _Batch([blocks[i] for i in chosen], names, model, config, rows)
        for i, number in enumerate(chosen):
            judged[number] = batch.judge(i, own[number], stores[number])
    return [judged[i] for i in range(len(blocks))]


class _Batch:
    """Some recordings, up to their windows."""

    def __init__(
        self,
        blocks: Sequence[SampleBlock],
        names: Sequence[str],
        model: Model,
        config: Config,
        rows: int,
    ) -> None:
        card = model.card
        self._names, self._card, self._config, self._blocks = names, card, config, blocks
        self._period_s = card.period_ns * 1e-9
        self._hypotheses = hypotheses.build(config.response)
        places = [names.index(name) for name in card.input_names]
        output = names.index(card.output.name)
        conditions = Enable.of(config.enable, names, card).block
        self._conditions = [conditions(block.values) for block in blocks]
        self._inputs = [block.values[:, places].astype(np.float32) for block in blocks]
        self._measured = [block.values[:, output].copy() for block in blocks]
        self._predicted = [np.full(len(block.t_ns), np.nan) for block in blocks]
        # of each recording: where a window begins, and what the bank reads in it
        self._banks: list[dict[int, FloatArray]] = [{} for _ in blocks]
        segments = [
            Segment(i, begin, end)
            for i, held in enumerate(self._conditions)
            for begin, end in runs(held[:, _INPUTS_VALID])
        ]
        segments.sort(key=lambda segment: segment.length, reverse=True)
        for first in range(0, len(segments), rows):
            self._run(model, segments[first : first + rows])

    def _run(self, model: Model, segments: Sequence[Segment]) -> None:
        """Run model and bank on the segments, the longest first."""
        lengths = [segment.length for segment in segments]
        u = np.zeros((len(segments), lengths[0], model.n_inputs), np.float32)
        measured = np.empty(len(segments))
        for row, (i, begin, end) in enumerate(segments):
            u[row, : end - begin] = self._inputs[i][begin:end]
            measured[row] = self._measured[i][begin]
        predicted = _predict(model, u, measured, lengths)
        at: list[tuple[int, int]] = []  # row and sample at which a window begins
        for row, (i, begin, end) in enumerate(segments):
            self._predicted[i][begin:end] = predicted[row, : end - begin]
            at += [(row, k) for k in self._windows(i, begin, end).tolist()]
        if not at:
            return
        n = self._config.window.n_samples
        row_of, begin_of = np.array(at).T
        steps = begin_of[:, np.newaxis] + np.arange(n)
        bank = BankBlock(self._hypotheses, self._period_s)
        read = bank.read(
            _oriented(predicted, self._card.transform), lengths, np.repeat(row_of, n), steps.ravel()
        ).reshape(-1, n, len(self._hypotheses))
        for (row, k), values in zip(at, read, strict=True):
            segment = segments[row]
            self._banks[segment.recording][segment.begin + k] = values

    def _windows(self, i: int, begin: int, end: int) -> IntArray:
        """Return where windows begin in a segment, counted from its begin."""
        usable = self._conditions[i][begin:end].all(axis=1)
        usable &= ~np.isnan(self._predicted[i][begin:end])
        return stretches(usable, self._config.window.n_samples)

    def judge(self, i: int, limits: Limits, store: DtcStore) -> Judged:
        """Return what is decided about one recording; the bank's values go with its windows."""
        conditions, card = self._conditions[i], self._card
        decisions = Decisions(
            limits, self._config, self._hypotheses, card.transform, self._period_s, store
        )
        found = sorted(self._results(i, decisions), key=itemgetter(0, 1))
        events = [event for *_, decide in found for event in decide()]
        return Judged(
            self._measured[i],
            self._predicted[i],
            conditions,
            np.asarray(conditions.all(axis=1)),
            [event for event in events if isinstance(event, WindowJudged)],
            [event for event in events if isinstance(event, DtcChanged)],
            store.active,
            decisions.completed,
            decisions.seen,
        )

    def _results(self, i: int, decisions: Decisions) -> Iterator[Result]:
        block, measured, conditions = self._blocks[i], self._measured[i], self._conditions[i]
        settings, output = self._config.plausibility, self._card.output
        t_ns = block.t_ns.tolist()
        tests = Plausibility(settings, self._names, output.name, self._period_s)
        for place, results in enumerate(tests.block(block.values, block.quality)):
            for k, result in _counting(results, *decisions.ticks_that_count):
                yield k, place, partial(decisions.ticks, (result,), t_ns[k])
        activity = ActivityTest.of(settings, output, self._names, self._period_s)
        active = conditions[:, BURNING].all(axis=1) & tests.running(block.values)
        for k, failed, fault in activity.block(measured, active):
            yield k, 3, partial(decisions.activity, failed, fault, t_ns[k])
        n = self._config.window.n_samples
        for index, begin in enumerate(sorted(self._banks[i])):
            last, inside = begin + n - 1, slice(begin, begin + n)
            window = Window(
                index,
                t_ns[begin],
                t_ns[last],
                measured[inside].copy(),
                self._predicted[i][inside].copy(),
                self._banks[i].pop(begin),
            )
            yield last, 4, partial(decisions.window, window)


def _counting(
    results: TickResults, failed_count: int, passed_count: int
) -> Iterator[tuple[int, TickResult]]:
    """Yield sample and result where a result can still move its counter.

    failed_count, passed_count : after so many alike in a row the counter stands
    """
    changed = np.diff(results.failed, prepend=~results.failed[:1])
    count = since(changed) < np.where(results.failed, failed_count, passed_count)
    for k, kind in zip(results.at[count].tolist(), results.kind[count].tolist(), strict=True):
        yield k, results.kinds[kind]


def _predict(
    model: Model, u: NDArray[np.float32], measured: FloatArray, lengths: Sequence[int]
) -> FloatArray:
    """Return the predictions (rows, n) of segments that begin like the streaming monitor does.

    u : (rows, n, n_inputs), zero behind a row's end; measured : (rows,) at each row's begin
    """
    predicted = np.full(u.shape[:2], np.nan)
    model = model.with_batch(len(u))
    model.reset(u[:, 0], measured)
    for begin, end, rows in phases(lengths):
        if rows < model.batch:
            model = model.keep(rows)
        predicted[:rows, begin:end] = model.run_batch(u[:rows, begin:end])
    return predicted


def _oriented(predicted: FloatArray, transform: str) -> FloatArray:
    """Return ``residual.oriented`` of an array."""
    if transform != "phi":
        return -predicted
    return np.divide(1.0, predicted, out=np.full_like(predicted, np.nan), where=predicted > 0.0)
