"""Steps 2 to 9 as one object without I/O: frames or samples in, events out.

Time comes with the frames, so a live bus and a replayed log run the same code.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, islice
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.types import Frame, Sample
from monitor.decode.bus_map import BusMap
from monitor.frames.loop_frames import CLEARED_ID
from monitor.grid.samples import FrameSamples
from monitor.judge import enable, hypotheses
from monitor.judge.decisions import Change, Counted, Decisions, DtcChanged, WindowJudged
from monitor.judge.enable import Enable
from monitor.judge.hypotheses import SensorBank
from monitor.judge.limits import Limits
from monitor.judge.plausibility import ActivityTest, Plausibility
from monitor.judge.residual import oriented
from monitor.judge.window import WindowCollector
from monitor.memory.cycles import SIGNALS as CYCLE_SIGNALS
from monitor.memory.cycles import Cycles, Moment
from monitor.memory.dtc import DtcStore, Status
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.reference import Seen
from monitor.model.card import ModelCard
from monitor.model.step import Model

__all__ = [
    "Counted",
    "CycleStarted",
    "DtcChanged",
    "Event",
    "FramePipeline",
    "Monitor",
    "Tick",
    "WindowJudged",
    "check_names",
    "needed_names",
]

# a live sensor must move while these hold and the engine runs, whatever the model's state
BURNING = tuple(
    map(enable.CONDITIONS.index, ("measured_valid", "fuel_cut_recovered", "sensor_ready"))
)
_burning = itemgetter(*BURNING)
_INPUTS_VALID = enable.CONDITIONS.index("inputs_valid")


class Tick(NamedTuple):
    """One sample went through the model."""

    sample: Sample
    predicted: float  # output's unit, NaN while an input is not valid
    conditions: tuple[bool, ...]  # in the order of enable.CONDITIONS
    enabled: bool


class CycleStarted(NamedTuple):
    """The next driving cycle begins; the changes of codes that it brings follow."""

    t_ns: int
    seen: Seen | None  # what the vehicle's reference may learn of the one before


Event = Tick | CycleStarted | WindowJudged | DtcChanged | Counted
_COUNT_S = 1.0  # driving is counted in steps of so much
AHEAD = 4096  # frames; switching less often between decoding and judging is a quarter faster


class Monitor:
    """Judges one sensor.

    names : what each sample holds; must contain the model's inputs and output
    store : fault memory; the first driving cycle begins in the caller's hands, any other where
        the samples show one
    Raises RecordingError if a signal the model needs is not among ``names``.
    """

    def __init__(
        self, model: Model, limits: Limits, config: Config, names: Iterable[str], store: DtcStore
    ) -> None:
        card = model.card
        self.names = tuple(names)
        check_names(card, self.names)
        period_s = card.period_ns * 1e-9
        at = {name: i for i, name in enumerate(self.names)}
        self.store, self.limits, self.output = store, limits, card.output.name
        self._model, self._transform = model, card.transform
        self._inputs = np.array([at[name] for name in card.input_names])
        self._output = at[card.output.name]
        self._enable = Enable.of(config.enable, self.names, card)
        bank = hypotheses.build(config.response)
        self._bank = SensorBank(bank, period_s)
        n = config.window.n_samples
        self._windows = WindowCollector(n, len(bank))
        self._decide = partial(
            Decisions,
            config=config,
            hypotheses=bank,
            transform=card.transform,
            period_s=period_s,
            store=store,
        )
        self._decisions = self._decide(limits)
        self._clearings = store.clearings
        running_rpm = config.plausibility.engine_running_rpm
        self._cycles = Cycles(
            config.cycles, config.profile, self.names, card.output.name, running_rpm
        )
        self._plausibility = Plausibility(
            config.plausibility, self.names, card.output.name, period_s
        )
        self._activity = ActivityTest.of(config.plausibility, card.output, self.names, period_s)
        self._running = False
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
    def seen(self) -> Seen | None:
        """Return what the vehicle's reference may learn of this drive, None if nothing."""
        return self._decisions.seen

    @property
    def interrupted_windows(self) -> int:
        """Return how many windows were begun and discarded."""
        return self._windows.discarded

    def push(self, sample: Sample) -> Iterator[Event]:
        """Take one sample and yield what it causes."""
        moments = self._cycles.push(sample)
        if self._cycles.engine_run_s >= _COUNT_S:
            self.store.drive(*self._cycles.take())
        if moments:
            yield from self._count(moments, sample.t_ns)
        if self._clearings != self.store.clearings:  # what was found before is forgotten
            self._clearings = self.store.clearings
            self._decisions = self._decide(self.limits)
        conditions = self._enable.step(sample)
        predicted = self._predict(sample, inputs_valid=conditions[_INPUTS_VALID])
        enabled = all(conditions)
        self.samples += 1
        self.enabled_samples += enabled
        yield Tick(sample, predicted, conditions, enabled)
        changed = self._decisions.ticks(self._plausibility.step(sample), sample.t_ns)
        if changed:
            yield from self._frozen(changed, sample)
        measured = sample.values.item(self._output)
        if all(_burning(conditions)) and self._plausibility.is_running(sample):
            judged = self._activity.push(measured)
            if judged is not None:
                yield from self._frozen(self._decisions.activity(*judged, sample.t_ns), sample)
        else:
            self._activity.reset()
        if math.isnan(predicted):
            self._windows.interrupt()
            return
        row = self._bank.push(oriented(predicted, self._transform))
        if not enabled:
            self._windows.interrupt()
            return
        window = self._windows.push(sample.t_ns, measured, predicted, row)
        if window is not None:
            yield from self._frozen(self._decisions.window(window), sample)

    def adopt(self, limits: Limits) -> None:
        """Judge with other limits from here on, with nothing concluded yet.

        For the limits of the vehicle's reference after it has learned, at a ``CycleStarted``.
        """
        self.limits = limits
        self._decisions = self._decide(limits)

    def _count(self, moments: Sequence[Moment], t_ns: int) -> Iterator[Event]:
        """Let the fault memory count; begin the next driving cycle."""
        store = self.store
        for moment in moments:
            match moment:
                case "driving_cycle":
                    yield from self._next_cycle(t_ns)
                    continue
                case "ignition_cycle":
                    store.count_ignition_cycle()
                case "warm_up":
                    store.count_warm_up()
                case "general_denominator":
                    store.count_general_denominator()
            yield Counted(t_ns, moment)

    def _next_cycle(self, t_ns: int) -> Iterator[Event]:
        """Begin the next driving cycle as one begins after switching on."""
        seen = self._decisions.seen
        were_active = {dtc.code for dtc in self.store.active}
        changed = self.store.start_driving_cycle()
        self._decisions = self._decide(self.limits)
        self._enable.reset()
        self._plausibility.reset()
        self._activity.reset()
        self._windows.interrupt()
        self._running = False
        yield CycleStarted(t_ns, seen)
        for dtc in changed:
            if dtc.code in were_active:
                yield DtcChanged(t_ns, dtc)

    def _frozen(
        self, events: Iterable[WindowJudged | Change], sample: Sample
    ) -> Iterator[WindowJudged | Change]:
        """Yield the events; what a code that fails is set by is kept with it."""
        for event in events:
            if isinstance(event, DtcChanged) and event.dtc.status & Status.TEST_FAILED:
                good = ~np.isnan(sample.values)
                values = zip(self.names, sample.values.tolist(), good.tolist(), strict=True)
                signals = {name: value for name, value, is_good in values if is_good}
                self.store.freeze(FreezeFrame(event.dtc.code, event.t_ns, signals))
            yield event

    def _predict(self, sample: Sample, *, inputs_valid: bool) -> float:
        if not inputs_valid:
            self._running = False
            return math.nan
        u = sample.values.take(self._inputs)
        if not self._running:
            measured = float(sample.values[self._output])
            self._model.reset(u, None if math.isnan(measured) else measured)
            self._bank.reset()
            self._running = True
        return self._model.step(u)


def check_names(card: ModelCard, names: Sequence[str]) -> None:
    """Raise RecordingError if a signal that the model needs is not among ``names``."""
    missing = [name for name in (*card.input_names, card.output.name) if name not in names]
    if missing:
        raise RecordingError(f"the model needs {', '.join(missing)}; there are {', '.join(names)}")


def needed_names(card: ModelCard, available: Collection[str]) -> tuple[str, ...]:
    """Return which of the available signals the monitor looks at, in its order."""
    wanted = (*card.input_names, card.output.name, *enable.SIGNALS, *CYCLE_SIGNALS)
    return tuple(name for name in dict.fromkeys(wanted) if name in available)


class FramePipeline:
    """Frames in, events out: decoder and assembler in front of a monitor."""

    def __init__(
        self, bus_map: BusMap, model: Model, limits: Limits, config: Config, store: DtcStore
    ) -> None:
        card = model.card
        names = needed_names(card, bus_map.names)
        self.monitor = Monitor(model, limits, config, names, store)
        self._samples = FrameSamples(bus_map, names, card.period_ns)
        self.decoder, self.assembler = self._samples.decoder, self._samples.assembler

    def push(self, frame: Frame) -> Iterable[Event]:
        """Take one frame and return what it causes, for most frames nothing."""
        samples = self._samples.push(frame)
        if frame[1] == CLEARED_ID and frame[2]:
            return self._clear(samples, frame[0])
        return chain.from_iterable(map(self.monitor.push, samples)) if samples else ()

    def push_all(self, frames: Iterable[Frame]) -> Iterator[Event]:
        """Yield what frames cause, as ``push`` does of each, decoding some of them ahead."""
        rest, push = iter(frames), self._samples.push
        while chunk := list(islice(rest, AHEAD)):
            samples: list[Sample] = []
            for frame in chunk:
                samples += push(frame)
                if frame[1] == CLEARED_ID and frame[2]:
                    yield from self._clear(samples, frame[0])
                    samples = []
            yield from chain.from_iterable(map(self.monitor.push, samples))

    def _clear(self, samples: Sequence[Sample], t_ns: int) -> Iterator[Event]:
        yield from chain.from_iterable(map(self.monitor.push, samples))
        for dtc in self.monitor.store.clear():
            yield DtcChanged(t_ns, dtc)
