"""Steps 4 to 9 as one object without I/O: blocks of samples in, events out.

Time comes with the samples, so a live bus and a recording run the same code: a live sample is a
block of one. No result depends on where blocks begin and end. Recordings with the same signals run
side by side: their blocks go through model and bank together.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, pairwise
from operator import itemgetter

import numpy as np

from monitor.base.config import Config
from monitor.base.runs import runs
from monitor.base.types import SampleBlock
from monitor.judge import enable
from monitor.judge.catalyst.watch import CatalystMonitor
from monitor.judge.decision import plugins as rules
from monitor.judge.decision.decisions import Decisions
from monitor.judge.electrical.suite import ElectricalTests
from monitor.judge.enable import Enable
from monitor.judge.limits import Limits, in_unit
from monitor.judge.window import Window, Windows
from monitor.memory.codes import BEHIND
from monitor.memory.cycles import Counting, Cycles
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import Model
from monitor.pipeline.conclusions import At, Conclusions, Findings, between
from monitor.pipeline.events import BlockEvent, DtcChanged, Ticks
from monitor.pipeline.names import check_names
from monitor.pipeline.segments import Filling, Part, RunState, Segments

SAMPLES = 2048  # of each recording that are judged at once


class Judge:
    """Judges recordings with the same signals, some at a time side by side.

    names : signals of a sample; must contain the model's inputs and output
    rows : most runs of samples that go through the model together
    Raises RecordingError if a signal the model needs is not among ``names``, ConfigError if a rule
        of the settings cannot be used.
    """

    def __init__(
        self, names: Iterable[str], model: Model, config: Config, *, rows: int = 64
    ) -> None:
        self.names, self.card, self.config = tuple(names), model.card, in_unit(config, model.card)
        check_names(self.card, self.names)
        self.period_s = self.card.period_ns * 1e-9
        self.rules = {name: rules.loaded(name) for name in config.rules.active}
        self.inputs = [self.names.index(name) for name in self.card.input_names]
        self._segments = Segments(model, config.response, self.inputs, self.period_s, rows)

    def push(
        self, monitors: Sequence["SensorMonitor"], blocks: Sequence[SampleBlock]
    ) -> list[Iterator[BlockEvent]]:
        """Return the events that the next block of each recording causes.

        They come one by one, and all of them must be taken before the next block.
        """
        parts = [each.begin(block) for each, block in zip(monitors, blocks, strict=True)]
        self._segments.run([part for own in parts for part in own])
        return [each.end(own) for each, own in zip(monitors, parts, strict=True)]


class SensorMonitor:
    """Judges one sensor.

    judge : for the signals of its samples
    store : fault memory; the first driving cycle begins in the caller's hands, any other where
        the samples show one
    is_live : the monitor listens itself, so a sensor that is silent from the start is at fault;
        in a recording it may be the wrong database, unless the memory knows the sensor
    """

    def __init__(
        self, judge: Judge, limits: Limits, store: DtcStore, *, is_live: bool = False
    ) -> None:
        config, card, names = judge.config, judge.card, judge.names
        self.judge, self.names, self.store = judge, names, store
        output, period_s = card.output, judge.period_s
        self.output, self._output = output.name, names.index(output.name)
        running_rpm = config.plausibility.engine_running_rpm
        self._cycles = Cycles(config.cycles, config.profile, names, output.name, running_rpm)
        self.enable = Enable.of(config.enable, names, card)
        self.electrical = ElectricalTests(
            config,
            names,
            output,
            period_s,
            limits,
            is_expected=is_live or bool(store.counts.sensor_heard),
        )
        self.catalyst = CatalystMonitor(config, names, period_s)
        n_samples = config.window.n_samples
        self.windows = Windows(n_samples)
        # an edge of a fuel cut takes one to two seconds, and a cut is soon over
        self._cut_windows = Windows(n_samples // 2, is_cut=True)
        self._run: RunState | None = None
        if judge.rules:
            store.admit()
        decide = partial(Decisions, config=config, card=card, store=store, rules=judge.rules)
        self._conclusions = Conclusions(names, limits, store, decide)
        self._clearings = store.clearings
        self.samples = self.enabled_samples = 0

    @property
    def limits(self) -> Limits:
        """Return the limits in force."""
        return self._conclusions.limits

    @property
    def decisions(self) -> Decisions:
        """Return the decisions of this driving cycle."""
        return self._conclusions.decisions

    @property
    def outcomes(self) -> dict[str, str]:
        """Return of each test of this vehicle whether it failed, passed or is undecided.

        Behind the catalyst only that is to be decided which its signals allow.
        """
        left = {*BEHIND} - {*self.catalyst.supported}
        found = self.decisions.outcomes.items()
        return {test: own for test, own in found if own != "undecided" or test not in left}

    def push(self, block: SampleBlock) -> Iterator[BlockEvent]:
        """Take a block of samples and yield its events; all of them must be taken."""
        return self.judge.push([self], [block])[0]

    def adopt(self, limits: Limits) -> None:
        """Judge with other limits from here on, with nothing concluded yet.

        For the limits of the vehicle's reference after it has learned, at a ``CycleStarted``.
        """
        self._conclusions.adopt(limits)

    def clear(self, t_ns: int) -> list[DtcChanged]:
        """Let a tester clear the codes; conclusions are forgotten with the next sample."""
        return [DtcChanged(t_ns, dtc) for dtc in self.store.clear()]

    def begin(self, block: SampleBlock) -> list[Part]:
        """Take a block through the steps before the model; return a part for each driving cycle."""
        counting, n = self._cycles.push(block), len(block.t_ns)
        if self._clearings != self.store.clearings:
            self.electrical.forget()
            self.catalyst.reset()
        starts = [k for k, moment in counting.moments if moment == "driving_cycle"]
        edges = sorted({0, *starts, n})
        return [self._part(block, a, b, counting, starts) for a, b in pairwise(edges)]

    def _part(
        self, block: SampleBlock, begin: int, end: int, counting: Counting, starts: Sequence[int]
    ) -> Part:
        """Take the samples from begin to end, in one driving cycle."""
        if begin in starts:
            self._start()
        own = block.part(begin, end)
        conditions = self.enable.push(own.values, own.quality)
        masks = enable.masks(conditions)
        burning = enable.holds(masks, enable.BURNING)
        electrical, running, _ = self.electrical.push(own.values, own.quality, burning)
        found = Findings(
            driven=between(counting.driven, begin, end),
            moments=between(counting.moments, begin, end),
            electrical=electrical,
            behind=[(each.at, each) for each in self.catalyst.push(own.values, running)],
        )
        enabled = enable.holds(masks, enable.ENABLED)
        in_cut = enable.holds(masks, enable.AROUND_FUEL_CUT, enable.RECOVERED)
        kinds = Filling(self.windows, enabled, []), Filling(self._cut_windows, in_cut, [])
        segments = runs(enable.holds(masks, enable.INPUTS_VALID))
        goes_on = begin == 0 and begin not in starts and bool(segments) and segments[0][0] == 0
        return Part(
            block=own,
            measured=own.values[:, self._output],
            conditions=conditions,
            enabled=enabled,
            segments=segments,
            found=found,
            kinds=kinds,
            run=self._run if goes_on else None,
            predicted=np.full(end - begin, np.nan),
        )

    def _start(self) -> None:
        """Begin a driving cycle as one begins after switching on."""
        self.enable = Enable.of(self.judge.config.enable, self.names, self.judge.card)
        self.electrical.reset()
        self.catalyst.reset()

    def end(self, parts: Sequence[Part]) -> Iterator[BlockEvent]:
        """Yield the events of parts that have been through the model: windows, then decisions."""
        for part in parts:
            self._run = part.end
            is_cleared = self._clearings != self.store.clearings
            self._clearings = self.store.clearings
            found = part.found._replace(cleared=[(0, None)] * is_cleared, items=self._items(part))
            told = 0  # samples whose ticks are out
            for n_ticks, events in self._conclusions.take(found, part.block):
                if told < n_ticks:
                    yield self._ticks(part, told, n_ticks)
                    told = n_ticks
                yield from events
            if told < len(part.measured):
                yield self._ticks(part, told, len(part.measured))

    def _items(self, part: Part) -> At[Window]:
        """Return the windows that are complete, each with its last sample."""
        series = part.block.t_ns, part.measured, part.predicted
        goes_on = part.run is not None
        found = [kind.windows.push(kind.spans, series, goes_on=goes_on) for kind in part.kinds]
        return sorted(chain(*found), key=itemgetter(0))

    def _ticks(self, part: Part, begin: int, end: int) -> Ticks:
        inside = slice(begin, end)
        enabled = part.enabled[inside]
        self.samples += end - begin
        self.enabled_samples += int(np.count_nonzero(enabled))
        block = part.block
        if end - begin < len(block.t_ns):
            block = block.part(begin, end)
        return Ticks(block, part.predicted[inside], part.conditions[inside], enabled)


def slices(block: SampleBlock, begin: int, end: int) -> Iterator[SampleBlock]:
    """Yield the samples from begin to end in blocks of ``SAMPLES``."""
    for first in range(begin, end, SAMPLES):
        yield block.part(first, min(first + SAMPLES, end))
