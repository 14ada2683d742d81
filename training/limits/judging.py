"""Recordings judged by the steps of the monitor, without files or frames."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, TypeVar

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, FloatArray, SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge.catalyst.watch import REAR
from monitor.judge.causes.causes import Asked, Cause, causes
from monitor.judge.causes.observation import Observation
from monitor.judge.enable import CONDITIONS, Enable
from monitor.judge.limits import Limits
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore
from monitor.memory.reference import Reference, Seen
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline import events
from monitor.pipeline.events import CutJudged, CycleStarted, DtcChanged, WindowJudged
from monitor.pipeline.monitor import Judge, SensorMonitor, slices
from monitor.pipeline.names import needed_names
from training.recordings.recording import Recording

_NONE, _NEITHER = np.empty(0), np.empty((0, len(CONDITIONS)), dtype=np.bool_)
_Kind = TypeVar("_Kind")


@dataclass(frozen=True, slots=True)
class Judged:
    """The monitor's judgement of one recording."""

    predicted: FloatArray  # (n,) output's unit, NaN while an input is not valid
    conditions: BoolArray  # (n, n_conditions) in the order of enable.CONDITIONS
    enabled: BoolArray  # (n,)
    windows: list[WindowJudged]
    cuts: list[CutJudged]
    interrupted_windows: int  # begun and discarded
    changes: list[DtcChanged]
    cycles: list[CycleStarted]  # driving cycles that begin within the recording
    dtcs: list[Dtc]  # pending or confirmed at the end
    completed: bool  # the response test reached a decision in the last driving cycle
    seen: Seen | None  # for the vehicle's reference to learn, of the last driving cycle
    reference: Reference  # of the vehicle in the last driving cycle
    limits: Limits  # that hold in the last driving cycle
    behind: dict[str, Any] | None = None  # of the catalyst, None without a downstream sensor
    explained: float | None = None  # share of the reading that the likeliest sensor explains


class RecordingJudge:
    """Judges recordings with the same signals.

    names : signals of a sample; must contain the model's inputs and output
    rows : how many recordings, and how many segments of theirs, run side by side
    keep_banks : whether each window keeps the bank's readings, a drive of half an hour some
        megabytes; else its ``bank`` is empty, (n, 0)
    Raises RecordingError if a signal the model needs is not among ``names``.
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
        self.steps, self.limits = Judge(names, model, config, rows=rows), limits
        self.rows, self.keep_banks = rows, keep_banks

    def judge(
        self,
        blocks: Sequence[SampleBlock],
        stores: Sequence[DtcStore] | None = None,
        references: Sequence[Reference] | None = None,
        clearings: Sequence[Sequence[Clearing]] | None = None,
    ) -> list[Judged]:
        """Return the verdicts on recordings, in their order.

        stores : fault memory of each recording, in which its driving cycle has begun; by default
            empty
        references : of each recording's vehicle, which learns from every driving cycle that ends
            within the recording; by default nothing is known, and nothing learned
        clearings : of each recording's codes, by a tester; by default none
        """
        n = len(blocks)
        if stores is None:
            stores = [DtcStore(profile=self.steps.config.profile) for _ in blocks]
            for store in stores:
                store.start_driving_cycle()
        known: Sequence[Reference | None] = references or [None] * n
        of_each = [*zip(blocks, stores, known, clearings or [()] * n, strict=True)]
        judged: dict[int, Judged] = {}
        order = sorted(range(n), key=lambda i: -len(blocks[i].t_ns))  # alike together
        for first in range(0, n, self.rows):
            runs = {i: _Run(self, *of_each[i]) for i in order[first : first + self.rows]}
            while now := [(run, block) for run in runs.values() for block in islice(run.blocks, 1)]:
                monitors, parts = [run.monitor for run, _ in now], [block for _, block in now]
                for (run, _), own in zip(now, self.steps.push(monitors, parts), strict=True):
                    for event in own:
                        run.take(event)
            judged |= {i: run.judged() for i, run in runs.items()}
        return [judged[i] for i in range(n)]


class _Run:
    """One recording on its way through a monitor.

    reference : of the vehicle, which learns; None is a vehicle of which nothing is kept
    """

    def __init__(
        self,
        judge: RecordingJudge,
        block: SampleBlock,
        store: DtcStore,
        reference: Reference | None,
        clearings: Sequence[Clearing],
    ) -> None:
        self._judge, self._reference = judge, reference
        self.monitor = SensorMonitor(judge.steps, self._limits(), store)
        self._events: list[events.BlockEvent] = []
        self.blocks = self._parts(block, clearings)

    def _limits(self) -> Limits:
        """Return the limits of the vehicle as far as it is known."""
        known = self._reference or Reference()
        return self._judge.limits.of_vehicle(known, self._judge.steps.config.bias)

    def _parts(self, block: SampleBlock, clearings: Sequence[Clearing]) -> Iterator[SampleBlock]:
        """Yield the recording in blocks; the codes are cleared between them."""
        begin = 0
        for end, t_ns in [*clearings, (len(block.t_ns), None)]:
            yield from slices(block, begin, end)
            if t_ns is not None:
                self._events += self.monitor.clear(t_ns)
            begin = end

    def take(self, event: events.BlockEvent) -> None:
        """Take one event; the reference learns from a driving cycle that is over."""
        if isinstance(event, WindowJudged) and not self._judge.keep_banks:
            window = replace(event.window, bank=event.window.bank[:, :0].copy())
            event = replace(event, window=window)
        self._events.append(event)
        if isinstance(event, CycleStarted):
            if self._reference and event.seen:
                bias = self._judge.steps.config.bias
                self._reference = self._reference.learn(event.seen, bias)
            self.monitor.adopt(self._limits())

    def _of(self, kind: type[_Kind]) -> list[_Kind]:
        return [event for event in self._events if isinstance(event, kind)]

    def judged(self) -> Judged:
        """Return the judgement at the recording's end."""
        monitor, ticks = self.monitor, self._of(events.Ticks)
        return Judged(
            predicted=np.concatenate([_NONE, *(each.predicted for each in ticks)]),
            conditions=np.concatenate([_NEITHER, *(each.conditions for each in ticks)]),
            enabled=np.concatenate([_NEITHER[:, 0], *(each.enabled for each in ticks)]),
            windows=self._of(WindowJudged),
            cuts=self._of(CutJudged),
            interrupted_windows=monitor.windows.discarded,
            changes=self._of(DtcChanged),
            cycles=self._of(CycleStarted),
            dtcs=monitor.store.active,
            completed=monitor.decisions.completed,
            seen=monitor.decisions.seen,
            reference=self._reference or Reference(),
            limits=monitor.limits,
            behind=monitor.catalyst.entry(),
            explained=monitor.decisions.facts.response.explained,
        )


def why_not(recording: Recording, card: ModelCard, config: Config) -> list[Cause]:
    """Return the signals and enable conditions that keep a recording from a verdict."""
    names, block, conditions, held = checked(recording, card, config)
    observation = Observation(conditions, names, config.plausibility, card.period_ns * 1e-9)
    observation.push(block.values, block.quality, held)
    return causes(observation.observed(), Asked(card, config))


def judge_recordings(
    recordings: Sequence[Recording],
    model: Model,
    limits: Limits,
    config: Config,
    *,
    rear: bool = False,
) -> list[Judged]:
    """Return the verdicts of a monitor with empty fault memory on one driving cycle each.

    rear : whether the catalyst and the sensor behind it are judged, too
    Recordings with the same signals run side by side, faster than one by one.
    Raises RecordingError if a recording lacks an input of the model.
    """
    alike: dict[tuple[str, ...], list[int]] = {}
    for i, recording in enumerate(recordings):
        alike.setdefault(_names(recording, model.card, rear=rear), []).append(i)
    judged: dict[int, Judged] = {}
    for names, places in alike.items():
        blocks = [_block(recordings[i], names) for i in places]
        judge = RecordingJudge(names, model, limits, config)
        judged |= dict(zip(places, judge.judge(blocks), strict=True))
    return [judged[i] for i in range(len(recordings))]


def checked(
    recording: Recording, card: ModelCard, config: Config
) -> tuple[tuple[str, ...], SampleBlock, Enable, BoolArray]:
    """Return names and samples of a recording, its conditions, and which held, (n, all)."""
    names = _names(recording, card)
    block, conditions = _block(recording, names), Enable.of(config.enable, names, card)
    return names, block, conditions, conditions.push(block.values, block.quality)


def _names(recording: Recording, card: ModelCard, *, rear: bool = False) -> tuple[str, ...]:
    return needed_names(card, [name for name in recording.names if rear or name not in REAR])


def _block(recording: Recording, names: Sequence[str]) -> SampleBlock:
    """Return the named signals of a recording; its first sample has the time 0 s."""
    order = [recording.names.index(name) for name in names]
    index = np.arange(len(recording.values))
    values, quality = recording.values[:, order], recording.quality[:, order]
    return SampleBlock(index, index * recording.period_ns, values, quality)
