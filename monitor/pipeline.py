"""Steps 2 to 9 as one object without I/O: frames or samples in, events out.

Time comes with the frames, so a live bus and a replayed log run the same code.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from monitor import enable, hypotheses
from monitor.assemble import Assembler
from monitor.bus_map import BusMap
from monitor.config import Config
from monitor.debounce import PASSED, Debounce
from monitor.decode import Decoder
from monitor.dtc import TESTS, Dtc, DtcStore
from monitor.enable import Enable
from monitor.errors import RecordingError
from monitor.evaluate import BiasRule, Outcome, ResponseRule, paper_failed
from monitor.hypotheses import SensorBank
from monitor.limits import Limits
from monitor.model import Model
from monitor.plausibility import ActivityTest, Plausibility
from monitor.residual import mean_and_std, oriented
from monitor.types import FloatArray, Frame, Sample
from monitor.window import Window, WindowCollector

# a live sensor must move while these hold, whatever the model's state
_burning = itemgetter(
    *map(enable.CONDITIONS.index, ("measured_valid", "fuel_cut_recovered", "sensor_ready"))
)
_INPUTS_VALID = enable.CONDITIONS.index("inputs_valid")


class Tick(NamedTuple):
    """One sample went through the model."""

    sample: Sample
    predicted: float  # output's unit, NaN while an input is not valid
    conditions: tuple[bool, ...]  # in the order of enable.CONDITIONS
    enabled: bool


@dataclass(frozen=True, slots=True)
class WindowJudged:
    """A window of residuals is full and judged."""

    window: Window
    mean: float  # of the residual, output's unit
    std: float
    paper_failed: bool
    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    statistics: dict[str, float | str | None]


@dataclass(frozen=True, slots=True)
class DtcChanged:
    """A trouble code has a new status."""

    t_ns: int
    dtc: Dtc


Event = Tick | WindowJudged | DtcChanged


class Monitor:
    """Judges one sensor.

    names : what each sample holds; must contain the model's inputs and output
    store : fault memory; a new driving cycle begins in the caller's hands
    Raises RecordingError if a signal the model needs is not among ``names``.
    """

    def __init__(
        self, model: Model, limits: Limits, config: Config, names: Iterable[str], store: DtcStore
    ) -> None:
        card = model.card
        self.names = tuple(names)
        needed = (*card.input_names, card.output.name)
        missing = [name for name in needed if name not in self.names]
        if missing:
            raise RecordingError(
                f"the model needs {', '.join(missing)}; there are {', '.join(self.names)}"
            )
        period_s = card.period_ns * 1e-9
        at = {name: i for i, name in enumerate(self.names)}
        self.store, self.limits, self.output = store, limits, card.output.name
        self._model, self._config, self._transform = model, config, card.transform
        self._inputs = np.array([at[name] for name in card.input_names])
        self._output = at[card.output.name]
        self._enable = Enable.of(config.enable, self.names, card)
        bank = hypotheses.build(config.response)
        self._bank = SensorBank(bank, period_s)
        n = config.window.n_samples
        self._windows = WindowCollector(n, len(bank))
        self._response = ResponseRule(
            config.response, bank, limits.noise, limits.excitation, period_s
        )
        self._bias = BiasRule(config.bias, limits.offset)
        self._plausibility = Plausibility(
            config.plausibility, self.names, card.output.name, period_s
        )
        self._activity = ActivityTest(config.plausibility, card.output.maximum, period_s)
        self._tick_steps = tuple(
            max(1, math.ceil(-PASSED * period_s / seconds))
            for seconds in (config.debounce.tick_fail_s, config.debounce.tick_pass_s)
        )
        self._debounce = dict.fromkeys(TESTS, Debounce())
        self._running = False
        self.completed = False  # the response test reached a decision
        self.samples = self.enabled_samples = 0

    @property
    def unavailable(self) -> tuple[str, ...]:
        """Return the enable conditions whose signals are not provided."""
        return self._enable.unavailable

    @property
    def interrupted_windows(self) -> int:
        """Return how many windows were begun and discarded."""
        return self._windows.discarded

    def push(self, sample: Sample) -> Iterator[Event]:
        """Take one sample and yield what it causes."""
        conditions = self._enable.step(sample)
        predicted = self._predict(sample, inputs_valid=conditions[_INPUTS_VALID])
        enabled = all(conditions)
        self.samples += 1
        self.enabled_samples += enabled
        yield Tick(sample, predicted, conditions, enabled)
        fail, passed = self._tick_steps
        for result in self._plausibility.step(sample):
            if self._is_new(result.test, result.failed):
                by = fail if result.failed else passed
                yield from self._step(result.test, result.failed, by, result.fault, (), sample.t_ns)
        measured = sample.values.item(self._output)
        if enabled or all(_burning(conditions)):
            judged = self._activity.push(measured)
            if judged is not None:
                yield from self._activity_judged(*judged, sample.t_ns)
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
            yield from self._judge(window)

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

    def _activity_judged(self, failed: bool, fault: str, t_ns: int) -> Sequence[Event]:
        debounce = self._config.debounce
        by = debounce.response_fail if failed else debounce.response_pass
        return self._step("activity", failed, by, fault, (), t_ns)

    def _judge(self, window: Window) -> Iterator[Event]:
        mean, std = mean_and_std(window.residual)
        frozen = (
            float(window.measured.max() - window.measured.min())
            <= self._config.plausibility.stuck_range
        )
        bias = self._bias.judge(mean, ignore=frozen)
        response = self._response.judge(self._orient(window.measured), window.bank, ignore=frozen)
        if bias.outcome == "failed" and response.fault == "gain_low":
            # an offset in lambda changes the gain in phi, so the two are not told apart here
            response = replace(response, outcome="inconclusive", fault=None)
        outcome, fault, also = response.outcome, response.fault, response.also
        if bias.outcome == "failed" and outcome != "failed":
            outcome, fault, also = "failed", bias.fault, ()
        yield WindowJudged(
            window,
            mean,
            std,
            paper_failed(mean, std, self.limits.j_mu, self.limits.j_sigma),
            outcome,
            fault,
            also,
            {**response.statistics, "offset": bias.offset},
        )
        debounce = self._config.debounce
        for test, result in (("response", response), ("bias", bias)):
            if result.outcome != "inconclusive":
                failed = result.outcome == "failed"
                by = debounce.response_fail if failed else debounce.response_pass
                name = result.fault or ""
                yield from self._step(test, failed, by, name, result.also, window.t_end_ns)
        self.completed |= self._debounce["response"].failed or self._debounce["response"].passed

    def _orient(self, measured: FloatArray) -> FloatArray:
        return 1.0 / measured if self._transform == "phi" else -measured

    def _is_new(self, test: str, failed: bool) -> bool:
        """Return whether a result can still change a test's debounce counter."""
        counter = self._debounce[test]
        return not (counter.failed if failed else counter.passed)

    def _step(
        self, test: str, failed: bool, by: int, fault: str, also: tuple[str, ...], t_ns: int
    ) -> Sequence[Event]:
        """Advance one test's debounce counter; a counter that matures sets or completes codes."""
        if not self._is_new(test, failed):
            return ()
        before = self._debounce[test]
        after = before.step(failed=failed, by=by)
        self._debounce[test] = after
        changed: list[Dtc] = []
        if after.failed and not before.failed:
            changed = self.store.fail(fault, t_ns, also)
        elif after.passed and not before.passed:
            changed = self.store.complete(test)
        return [DtcChanged(t_ns, dtc) for dtc in changed]


class FramePipeline:
    """Frames in, events out: decoder and assembler in front of a monitor."""

    def __init__(
        self, bus_map: BusMap, model: Model, limits: Limits, config: Config, store: DtcStore
    ) -> None:
        card = model.card
        wanted = dict.fromkeys((*card.input_names, card.output.name, *enable.SIGNALS))
        names = [name for name in wanted if name in bus_map.names]
        self.monitor = Monitor(model, limits, config, names, store)
        self.decoder = Decoder(bus_map, names)
        self.assembler = Assembler.of(self.decoder, card.period_ns)

    def samples(self, frame: Frame) -> Sequence[Sample]:
        """Take one frame and return the samples it completes, not judged yet."""
        return self.assembler.push(frame[0], self.decoder.push(frame))

    def push(self, frame: Frame) -> Iterable[Event]:
        """Take one frame and return what it causes, for most frames nothing."""
        samples = self.samples(frame)
        return chain.from_iterable(map(self.monitor.push, samples)) if samples else ()
