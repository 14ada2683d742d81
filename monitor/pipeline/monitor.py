"""Steps 4 to 9 as one object without I/O: blocks of samples in, events out.

Time comes with the samples, so a live bus and a recording run the same code: a live sample is a
block of one. No result depends on where blocks begin and end. Recordings with the same signals run
side by side: their blocks go through model and bank together.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from operator import itemgetter
from types import MappingProxyType

import numpy as np

from monitor.base.config import Config
from monitor.base.errors import MissingSignalsError
from monitor.base.runs import runs
from monitor.base.signals import CAPACITY
from monitor.base.types import SampleBlock
from monitor.judge import bank, enable, rules
from monitor.judge.catalyst import REAR, BehindResult, CatalystMonitor
from monitor.judge.catalyst import SIGNALS as CATALYST_SIGNALS
from monitor.judge.decisions import Decisions
from monitor.judge.electrical import ElectricalTests
from monitor.judge.enable import Enable
from monitor.judge.findings import Evidence, Facts
from monitor.judge.fuel_cut import Cut
from monitor.judge.fuel_cut_response import FuelCutResponse
from monitor.judge.heater import DUTY
from monitor.judge.limits import Limits
from monitor.judge.observation import Observation
from monitor.judge.plausibility import TickResult
from monitor.judge.window import Series, Window, Windows
from monitor.memory.codes import BEHIND
from monitor.memory.cycles import SIGNALS as CYCLE_SIGNALS
from monitor.memory.cycles import Cycles, Driven, Moment
from monitor.memory.dtc import Status
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.reference import Seen
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.events import (
    BlockEvent,
    Change,
    Counted,
    CutJudged,
    CycleStarted,
    DtcChanged,
    Happening,
    Ticks,
    WindowJudged,
)
from monitor.pipeline.fuel_cuts import CutWatch
from monitor.pipeline.segments import Part, RunState, Segments, Then

# the order of what happens at one sample; its tick comes before those from _MATURED on
_DRIVEN, _COUNTED, _WINDOWS_KNOWN, _MATURED, _ACTIVE, _BEHIND, _JUDGED = range(7)


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
        self.names, self.card, self.config = tuple(names), model.card, config
        check_names(self.card, self.names)
        self.period_s = self.card.period_ns * 1e-9
        self.hypotheses = bank.build(config.response)
        self.rules = rules.loaded(config.rules.active)
        self.inputs = [self.names.index(name) for name in self.card.input_names]
        self._segments = Segments(model, self.hypotheses, self.inputs, self.period_s, rows)

    def push(
        self, monitors: Sequence["Monitor"], blocks: Sequence[SampleBlock]
    ) -> list[Iterator[BlockEvent]]:
        """Return the events that the next block of each recording causes.

        They come one by one, and all of them must be taken before the next block.
        """
        pairs = list(zip(monitors, blocks, strict=True))
        parts = [monitor.begin(block) for monitor, block in pairs]
        self._segments.run(parts)
        return [monitor.end(part) for monitor, part in zip(monitors, parts, strict=True)]


class Monitor:
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
        self._judge, self.names = judge, names
        self.store, self.limits, self.output = store, limits, card.output.name
        self._output = names.index(self.output)
        output, period_s = card.output, judge.period_s
        running_rpm = config.plausibility.engine_running_rpm
        self._cycles = Cycles(config.cycles, config.profile, names, output.name, running_rpm)
        self._enable = Enable.of(config.enable, names, card)
        self._electrical = ElectricalTests(
            config,
            names,
            output,
            period_s,
            still_s=limits.still_s,
            still_end_s=limits.still_end_s,
            is_expected=is_live or bool(store.counts.sensor_heard),
        )
        self.catalyst = CatalystMonitor(config.catalyst, names, period_s)
        n_samples, n_hypotheses = config.window.n_samples, len(judge.hypotheses)
        self._windows = Windows(n_samples, n_hypotheses)
        # an edge of a fuel cut takes one to two seconds, and a cut is soon over
        is_judged = limits.evidence_cut > 0.0
        cut_windows = Windows(n_samples // 2, n_hypotheses, is_cut=True)
        self._cut_windows = cut_windows if is_judged else None
        has_cut = "fuel_cut" in names
        self._cuts = CutWatch(config, card, names) if has_cut else None
        self._run: RunState | None = None
        self._driven: list[Driven] = []  # not counted yet
        self._decide = partial(
            Decisions,
            config=config,
            hypotheses=judge.hypotheses,
            transform=card.transform,
            end=output.maximum,
            period_s=period_s,
            store=store,
            rules=judge.rules,
        )
        if judge.rules:
            store.admit()
        self._decisions = self._decide(limits)
        self._facts: Iterator[Facts] = iter(())
        self._clearings = store.clearings
        self._has_begun = False
        self.samples = self.enabled_samples = 0

    @property
    def unavailable(self) -> tuple[str, ...]:
        """Return the enable conditions whose signals are not provided."""
        return self._enable.unavailable

    @property
    def completed(self) -> bool:
        """Return whether the response test has reached a decision."""
        return self._decisions.completed

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Return the tests that have reached no decision in this driving cycle.

        Behind the catalyst only that is to be decided which its signals allow.
        """
        behind = self.catalyst.supported
        return tuple(t for t in self._decisions.unfinished if t not in BEHIND or t in behind)

    @property
    def fuel_cuts(self) -> FuelCutResponse:
        """Return the test of the fuel-cut response in this driving cycle."""
        return self._decisions.fuel_cuts

    def evidence(self) -> dict[str, Evidence]:
        """Return how far the response test is from a decision about each fault."""
        return self._decisions.evidence()

    def prefailed(self) -> dict[str, int]:
        """Return the codes that are about to fail, with the counters of their tests, 1 to 126."""
        return self._decisions.prefailed()

    def probability(self, fault: str) -> float:
        """Return the probability of a fault's name among the names with the same code."""
        return self._decisions.probability(fault)

    def observation(self) -> Observation:
        """Return a count of this monitor's samples that begins with the next one."""
        judge = self._judge
        config, period_s = judge.config.plausibility, judge.period_s
        return Observation(self._enable, self.names, config, period_s)

    @property
    def judge(self) -> Judge:
        """Return the judge of the samples."""
        return self._judge

    @property
    def seen(self) -> Seen | None:
        """Return the lesson of this drive for the vehicle's reference, None without one."""
        return self._decisions.seen

    @property
    def interrupted_windows(self) -> int:
        """Return how many windows were begun and discarded."""
        return self._windows.discarded

    def expect_sensor(self) -> None:
        """Take a sensor that is silent from the start for a fault from here on."""
        self._electrical.expect_sensor()

    def push(self, block: SampleBlock) -> Iterator[BlockEvent]:
        """Take a block of samples and yield its events; all of them must be taken."""
        return self._judge.push([self], [block])[0]

    def adopt(self, limits: Limits) -> None:
        """Judge with other limits from here on, with nothing concluded yet.

        For the limits of the vehicle's reference after it has learned, at a ``CycleStarted``.
        """
        self.limits = limits
        self._decisions = self._decide(limits)

    def clear(self, t_ns: int) -> list[DtcChanged]:
        """Let a tester clear the codes; conclusions are forgotten with the next sample."""
        return [DtcChanged(t_ns, dtc) for dtc in self.store.clear()]

    def begin(self, block: SampleBlock) -> Part:
        """Take a block through the steps before the model."""
        values, n = block.values, len(block.t_ns)
        counting = self._cycles.push(block)
        cuts = [k for k, moment in counting.moments if moment == "driving_cycle"]
        then: list[Then] = []
        if n and not self._has_begun:
            self._has_begun = True
            then.append((0, _DRIVEN, partial(self._judge_memory, block, 0)))
        for k, driven in counting.driven:
            then.append((k, _DRIVEN, partial(self._drive, driven)))
        for k, moment in counting.moments:
            then.append((k, _COUNTED, partial(self._count, moment, block, k)))
        if self._clearings != self.store.clearings:
            self._electrical.forget()
            self.catalyst.reset()
        measured = values[:, self._output]
        conditions = np.empty((n, len(enable.CONDITIONS)), dtype=np.bool_)
        masks = np.empty(n, dtype=np.uint16)
        segments: list[tuple[int, int]] = []
        for begin, end in pairwise(sorted({0, *cuts, n})):
            if begin in cuts:
                self._start()
            part = slice(begin, end)
            own = values[part]
            held = conditions[part] = self._enable.push(own, block.quality[part])
            mask = masks[part] = enable.masks(held)
            segments += [(begin + a, begin + b) for a, b in runs(enable.INPUTS_VALID[mask])]
            found = self._electrical.push(own, block.quality[part], enable.BURNING[mask])
            for k, result in found.matured:
                happen = partial(self._mature, result, block, begin + k)
                then.append((begin + k, _MATURED, happen))
            for k, failed, fault in found.stretches:
                act = partial(self._act, block, begin + k, failed=failed, fault=fault)
                then.append((begin + k, _ACTIVE, act))
            for behind in self.catalyst.push(own, found.running):
                k = begin + behind.at
                then.append((k, _BEHIND, partial(self._judge_behind, behind, block, k)))
        goes_on = bool(segments) and segments[0][0] == 0 and 0 not in cuts
        run = self._run if goes_on else None
        return Part(
            block=block,
            measured=measured,
            conditions=conditions,
            enabled=enable.ENABLED[masks],
            cuts=cuts,
            segments=segments,
            then=then,
            windows=self._windows,
            in_cut=enable.IN_FUEL_CUT[masks],
            cut_windows=self._cut_windows,
            run=run,
        )

    def _start(self) -> None:
        """Begin a driving cycle as one begins after switching on."""
        self._enable.reset()
        self._electrical.reset()
        self.catalyst.reset()

    def end(self, part: Part) -> Iterator[BlockEvent]:
        """Yield the events of a block that has been through the model."""
        if len(part.measured) == 0:
            return
        self._run = part.end
        inputs = part.block.values.take(self._judge.inputs, axis=1)
        series = Series(part.block.t_ns, part.measured, part.predicted, inputs)
        goes_on = part.run is not None
        windows = self._windows.push(part.spans, series, goes_on=goes_on)
        if self._cut_windows is not None:
            windows += self._cut_windows.push(part.cut_spans, series, goes_on=goes_on)
        cuts = self._cuts.over(part) if self._cuts else []
        items: list[tuple[int, Window | Cut]] = sorted([*windows, *cuts], key=itemgetter(0))
        then = part.then
        is_cleared, self._clearings = self._clearings != self.store.clearings, self.store.clearings
        edges = sorted({0, *part.cuts, len(part.measured)})
        for begin, end in pairwise(edges):
            own = [item for k, item in items if begin <= k < end]
            anew = is_cleared and begin == 0
            if own or anew:
                then.append((begin, _WINDOWS_KNOWN, partial(self._know, own, anew=anew)))
        for k, item in items:
            then.append((k, _JUDGED, partial(self._judged, item, part.block, k)))
        then.sort(key=itemgetter(0, 1))
        yield from self._events(part, then)

    def _events(self, part: Part, then: Sequence[Then]) -> Iterator[BlockEvent]:
        """Yield the happenings in the order of time, with the ticks before them."""
        at = 0
        for k, order, happen in then:
            events = happen()
            if events:
                self._count_driven()
                stop = k + (order >= _MATURED)
                if at < stop:
                    yield self._ticks(part, at, stop)
                    at = stop
                yield from events
        self._count_driven()
        if at < len(part.measured):
            yield self._ticks(part, at, len(part.measured))

    def _ticks(self, part: Part, begin: int, end: int) -> Ticks:
        inside = slice(begin, end)
        enabled = part.enabled[inside]
        self.samples += end - begin
        self.enabled_samples += int(np.count_nonzero(enabled))
        block = part.block
        if end - begin < len(block.t_ns):
            block = block.part(begin, end)
        return Ticks(block, part.predicted[inside], part.conditions[inside], enabled)

    def _drive(self, driven: Driven) -> Iterable[Happening]:
        self._driven.append(driven)
        return ()

    def _judge_memory(self, block: SampleBlock, k: int) -> Iterable[Happening]:
        """Judge the fault memory itself at the first sample of a driving cycle."""
        t_ns = block.t_ns.item(k)
        changed = [DtcChanged(t_ns, dtc) for dtc in self.store.judge_memory(t_ns) if dtc.state]
        return list(self._frozen(changed, block, k))

    def _count_driven(self) -> None:
        """Let the fault memory count the driving since it last did."""
        if self._driven:
            self.store.drive(self._driven)
            self._driven = []

    def _know(self, items: Sequence[Window | Cut], *, anew: bool) -> Iterable[Happening]:
        """Take the windows and fuel cuts up to the next driving cycle or the end of the block.

        anew : forget the conclusions so far
        """
        if anew:
            self._decisions = self._decide(self.limits)
        self._facts = iter(self._decisions.facts(items) if items else ())
        return ()

    def _count(self, moment: Moment, block: SampleBlock, k: int) -> Iterator[Happening]:
        """Let the fault memory count at sample k; begin the next driving cycle."""
        store, t_ns = self.store, block.t_ns.item(k)
        match moment:
            case "driving_cycle":
                yield from self._next_cycle(t_ns)
                yield from self._judge_memory(block, k)
                return
            case "ignition_cycle":
                store.count_ignition_cycle()
            case "warm_up":
                store.count_warm_up()
            case "general_denominator":
                store.count_general_denominator()
        yield Counted(t_ns, moment)

    def _next_cycle(self, t_ns: int) -> Iterator[Happening]:
        seen = self._decisions.seen
        were_active = {dtc.code for dtc in self.store.active}
        changed = self.store.start_driving_cycle()
        self._decisions = self._decide(self.limits)
        yield CycleStarted(t_ns, seen)
        for dtc in changed:
            if dtc.code in were_active:
                yield DtcChanged(t_ns, dtc)

    def _mature(self, result: TickResult, block: SampleBlock, k: int) -> Iterator[Happening]:
        yield from self._frozen(self._decisions.matured(result, block.t_ns.item(k)), block, k)

    def _act(self, block: SampleBlock, k: int, *, failed: bool, fault: str) -> Iterator[Happening]:
        changes = self._decisions.activity(failed, fault, block.t_ns.item(k))
        yield from self._frozen(changes, block, k)

    def _judge_behind(
        self, result: BehindResult, block: SampleBlock, k: int
    ) -> Iterable[Happening]:
        t_ns = block.t_ns.item(k)
        self.store.report(result.results)
        changes = self._decisions.behind(result.test, result.claim, t_ns)
        grams = result.capacity_g
        estimates = {} if grams is None else {CAPACITY: grams}
        return list(self._frozen(changes, block, k, estimates))

    def _judged(self, item: Window | Cut, block: SampleBlock, k: int) -> Iterator[Happening]:
        if isinstance(item, Cut):
            yield from self._decisions.cut_over(item, block.t_ns.item(k))
            return
        decide = self._decisions.cut if item.is_cut else self._decisions.window
        yield from self._frozen(decide(item, next(self._facts)), block, k)

    def _frozen(
        self,
        events: Iterable[WindowJudged | CutJudged | Change],
        block: SampleBlock,
        k: int,
        estimates: Mapping[str, float] = MappingProxyType({}),
    ) -> Iterator[WindowJudged | CutJudged | Change]:
        """Yield the events; with a code that fails, the signals of sample k are kept.

        estimates : what is kept beside them
        """
        for event in events:
            if isinstance(event, DtcChanged) and event.dtc.status & Status.TEST_FAILED:
                values = block.values[k]
                good = ~np.isnan(values)
                read = zip(self.names, values.tolist(), good.tolist(), strict=True)
                signals = {name: value for name, value, is_good in read if is_good}
                signals |= estimates
                self.store.freeze(FreezeFrame(event.dtc.code, event.t_ns, signals))
            yield event


def check_names(card: ModelCard, names: Sequence[str]) -> None:
    """Raise RecordingError if a signal that the model needs is not among ``names``."""
    lacking = lacking_names(card, names)
    if lacking:
        raise MissingSignalsError(needs(lacking, names))


def lacking_names(card: ModelCard, names: Sequence[str]) -> list[str]:
    """Return the signals that the model needs and that are not among ``names``."""
    return [name for name in (*card.input_names, card.output.name) if name not in names]


def needs(lacking: Sequence[str], names: Sequence[str]) -> str:
    """Return in words which signals lack and which are there."""
    return f"the model needs {', '.join(lacking)}; there are {', '.join(names)}"


def needed_names(card: ModelCard, available: Collection[str]) -> tuple[str, ...]:
    """Return which of the available signals the monitor looks at, in its order."""
    wanted = (*card.input_names, card.output.name, *enable.SIGNALS, *CYCLE_SIGNALS, DUTY)
    if any(name in available for name in REAR):
        wanted = (*wanted, *CATALYST_SIGNALS)
    return tuple(name for name in dict.fromkeys(wanted) if name in available)
