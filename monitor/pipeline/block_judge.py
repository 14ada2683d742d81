"""Whole recordings side by side, with the same results as ``pipeline.Monitor``.

Conditions and plausibility of a driving cycle are judged as arrays. Every run of samples with valid
inputs is a segment, begun like the streaming monitor begins; segments of many recordings are rows
that model and bank step together. Decisions are the monitor's own. A property test holds the two
together, bit for bit; only distances and running times are not counted in the fault memory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.config import Config
from monitor.base.types import BoolArray, FloatArray, SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge import hypotheses
from monitor.judge.block_bank import BankBlock, phases
from monitor.judge.decisions import Decisions, DtcChanged, WindowJudged
from monitor.judge.limits import Limits
from monitor.memory.dtc import Dtc, DtcStore
from monitor.memory.reference import Reference, Seen
from monitor.model.step import Model
from monitor.pipeline.course import Course, Vehicle
from monitor.pipeline.recording import Reader, Recording
from monitor.pipeline.stream import CycleStarted, check_names


@dataclass(frozen=True, slots=True)
class Judged:
    """What the monitor makes of one recording."""

    measured: FloatArray  # (n,) output's unit
    predicted: FloatArray  # (n,) output's unit, NaN while an input is not valid
    conditions: BoolArray  # (n, n_conditions) in the order of enable.CONDITIONS
    enabled: BoolArray  # (n,)
    windows: list[WindowJudged]
    interrupted_windows: int  # begun and discarded
    changes: list[DtcChanged]
    cycles: list[CycleStarted]  # driving cycles that begin within the recording
    dtcs: list[Dtc]  # pending or confirmed at the end
    completed: bool  # the response test reached a decision in the last driving cycle
    seen: Seen | None  # what the vehicle's reference may learn of the last driving cycle
    reference: Reference  # what was known of the vehicle in the last driving cycle
    limits: Limits  # that hold in the last driving cycle


class Segment(NamedTuple):
    """A run of samples with valid inputs."""

    recording: Recording
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
    clearings: Sequence[Sequence[Clearing]] | None = None,
    *,
    keep_banks: bool = True,
) -> list[Judged]:
    """Return the verdicts on recordings, in their order.

    names : what each sample holds; must contain the model's inputs and output
    stores : fault memory of each recording, in which its driving cycle has begun; by default empty
    references : of each recording's vehicle, which learns from every driving cycle that ends
        within the recording; by default nothing is known, and nothing learned
    rows : how many recordings, and how many segments of theirs, run side by side
    clearings : of each recording's codes, by a tester; by default none
    keep_banks : whether each window keeps what the bank read in it, a drive of half an hour some
        megabytes; else its ``bank`` is empty, (n, 0)
    Raises RecordingError if a signal the model needs is not among ``names``.
    """
    judge = BlockJudge(names, model, limits, config, rows, keep_banks=keep_banks)
    return judge.judge(blocks, stores, references, clearings)


class BlockJudge:
    """Judges recordings with the same signals; arguments as for ``judge_all``.

    One that judges many recordings, some at a time, uses its memory again.
    """

    def __init__(
        self,
        names: Sequence[str],
        model: Model,
        limits: Limits,
        config: Config,
        rows: int = 64,
        *,
        keep_banks: bool = True,
    ) -> None:
        check_names(model.card, names)
        self._model, self._limits, self._config, self._rows = model, limits, config, rows
        self._keep_banks = keep_banks
        self._reader = Reader(names, model.card, config)
        self._hypotheses = hypotheses.build(config.response)
        self._bank = BankBlock(self._hypotheses, self._reader.period_s)
        self._memory, self._taken = np.empty((0, 0, 0)), 0  # windows of it that are in use
        self._to_mature = self._decisions(DtcStore())(limits).ticks_to_mature

    def _decisions(self, store: DtcStore) -> Callable[[Limits], Decisions]:
        """Return what makes the decisions of a driving cycle."""
        return partial(
            Decisions,
            config=self._config,
            hypotheses=self._hypotheses,
            transform=self._model.card.transform,
            period_s=self._reader.period_s,
            store=store,
        )

    def judge(
        self,
        blocks: Sequence[SampleBlock],
        stores: Sequence[DtcStore] | None = None,
        references: Sequence[Reference] | None = None,
        clearings: Sequence[Sequence[Clearing]] | None = None,
    ) -> list[Judged]:
        """Return the verdicts on recordings, in their order."""
        if stores is None:
            stores = [DtcStore(profile=self._config.profile) for _ in blocks]
            for store in stores:
                store.start_driving_cycle()
        judged: dict[int, Judged] = {}
        order = sorted(range(len(blocks)), key=lambda i: len(blocks[i].t_ns))  # alike together
        for first in range(0, len(order), self._rows):
            chosen = order[first : first + self._rows]
            for i, recording in zip(chosen, self._run([blocks[i] for i in chosen]), strict=True):
                reference = references[i] if references else None
                own = clearings[i] if clearings else ()
                judged[i] = self._decide(recording, stores[i], reference, own)
        return [judged[i] for i in range(len(blocks))]

    def _run(self, blocks: Sequence[SampleBlock]) -> list[Recording]:
        """Return recordings up to their windows."""
        self._taken = 0
        recordings = [Recording(block, self._reader) for block in blocks]
        segments = [Segment(each, *ends) for each in recordings for ends in each.segments()]
        segments.sort(key=lambda segment: segment.length, reverse=True)
        for first in range(0, len(segments), self._rows):
            self._run_rows(segments[first : first + self._rows])
        return recordings

    def _run_rows(self, segments: Sequence[Segment]) -> None:
        """Run model and bank on the segments, the longest first."""
        lengths = [segment.length for segment in segments]
        # what the model takes in one step lies together in memory
        steps = np.zeros((lengths[0], len(segments), self._model.n_inputs), np.float32)
        u = steps.transpose(1, 0, 2)
        measured = np.empty(len(segments))
        for row, (recording, begin, end) in enumerate(segments):
            u[row, : end - begin] = recording.inputs[begin:end]
            measured[row] = recording.measured[begin]
        predicted = _predict(self._model, u, measured, lengths)
        at: list[tuple[int, int]] = []  # row and sample at which a window begins
        for row, (recording, begin, end) in enumerate(segments):
            recording.predicted[begin:end] = predicted[row, : end - begin]
            at += [(row, k) for k in recording.windows(begin, end).tolist()]
        if not at:
            return
        rows, begins = np.array(at).T
        oriented = _oriented(predicted, self._model.card.transform)
        read = self._room(len(at))
        self._bank.read(oriented, lengths, rows, begins, read)
        for (row, k), values in zip(at, read, strict=True):
            segments[row].recording.banks[segments[row].begin + k] = values

    def _room(self, n_windows: int) -> FloatArray:
        """Return memory for what the bank reads in so many windows.

        Unless windows keep it, it is used again for every batch: memory that is new to a process
        costs more than what is written there.
        """
        shape = self._config.window.n_samples, len(self._hypotheses)
        if self._keep_banks:
            return np.empty((n_windows, *shape))
        end = self._taken + n_windows
        if end > len(self._memory):
            self._memory = np.empty((2 * end, *shape))
        self._taken, room = end, self._memory[self._taken : end]
        return room

    def _decide(
        self,
        recording: Recording,
        store: DtcStore,
        reference: Reference | None,
        clearings: Sequence[Clearing],
    ) -> Judged:
        """Return what is decided about one recording; the bank's values go with its windows."""
        vehicle = Vehicle(self._limits, self._config.bias, reference)
        course = Course(recording.block, self._reader.names, self._decisions(store), store, vehicle)
        for *_, happen in recording.happenings(
            clearings, self._to_mature, keep_banks=self._keep_banks
        ):
            happen(course)
        conditions = recording.conditions
        return Judged(
            recording.measured,
            recording.predicted,
            conditions,
            np.asarray(conditions.all(axis=1)),
            course.windows,
            recording.interrupted(),
            course.changes,
            course.cycles,
            store.active,
            course.decisions.completed,
            course.decisions.seen,
            vehicle.reference,
            vehicle.limits,
        )


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
