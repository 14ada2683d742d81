"""Step 9: findings on samples, in the order of time, become verdicts, codes and counts."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from types import MappingProxyType
from typing import Final, NamedTuple, TypeVar

from monitor.base.signals import CAPACITY
from monitor.base.types import FloatArray, SampleBlock
from monitor.judge.catalyst.watch import BehindResult
from monitor.judge.decision.decisions import Decisions
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.findings import Facts
from monitor.judge.limits import Limits
from monitor.judge.window import Window
from monitor.memory.cycles import Driven, Moment
from monitor.memory.dtc import Status
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.pipeline.events import (
    Change,
    Counted,
    CutJudged,
    CycleStarted,
    DtcChanged,
    Happening,
    WindowJudged,
)

_AFTER_TICK: Final = 3  # from this field of ``Findings`` on
_Found = TypeVar("_Found")
At = Sequence[tuple[int, _Found]]  # findings, each with its sample's number, which never falls


class Findings(NamedTuple):
    """The findings on a block, in the order in which those of one sample take effect."""

    driven: At[Driven]
    moments: At[Moment]
    cleared: At[None] = ()  # a tester has cleared the codes
    electrical: At[TickResult] = ()
    behind: At[BehindResult] = ()
    items: At[Window] = ()


def between(found: At[_Found], begin: int, end: int) -> At[_Found]:
    """Return the findings on samples from begin to end, which count from begin."""
    return [(k - begin, each) for k, each in found if begin <= k < end]


class SamplePlace(NamedTuple):
    """A sample of a block."""

    block: SampleBlock
    k: int

    @property
    def t_ns(self) -> int:
        """Return the time of the sample."""
        return self.block.t_ns.item(self.k)


class Conclusions:
    """Takes findings and yields the events that each causes.

    names : signals of a sample
    decide : begins the decisions of a driving cycle
    """

    def __init__(
        self,
        names: Sequence[str],
        limits: Limits,
        store: DtcStore,
        decide: Callable[[Limits], Decisions],
    ) -> None:
        self._names, self._store, self._decide = names, store, decide
        self._facts: Iterator[Facts] | None = None  # of the windows of a block
        self._has_begun = False
        self.adopt(limits)

    def adopt(self, limits: Limits) -> None:
        """Judge with other limits from here on, with nothing concluded yet."""
        self.limits = limits
        self.decisions = self._decide(limits)

    def take(
        self, found: Findings, block: SampleBlock
    ) -> Iterator[tuple[int, Iterable[Happening]]]:
        """Yield events in the order of time, with the number of samples whose ticks come first.

        Cycles, memory and windows come before the tick of their sample, the others behind it.
        """
        if not self._has_begun:
            self._has_begun = True
            yield 0, self._judge_memory(SamplePlace(block, 0))
        self._facts = None
        self._windows = [window for _, window in found.items]
        steps: tuple[Callable[..., Iterable[Happening]], ...] = (
            self._drive,
            self._count,
            self._forget,
            self._electrical,
            self._judge_behind,
            self._judge,
        )
        merged = sorted(
            ((k, step, each) for step, own in enumerate(found) for k, each in own),
            key=itemgetter(0, 1),
        )
        for k, step, each in merged:
            events = steps[step](each, SamplePlace(block, k))
            if events:
                yield k + (step >= _AFTER_TICK), events

    def _drive(self, driven: Driven, _: SamplePlace) -> Iterable[Happening]:
        """Let the fault memory count driving."""
        self._store.drive(*driven)
        return ()

    def _count(self, moment: Moment, at: SamplePlace) -> Iterator[Happening]:
        """Let the fault memory count; begin the next driving cycle."""
        store = self._store
        match moment:
            case "driving_cycle":
                yield from self._next_cycle(at.t_ns)
                yield from self._judge_memory(at)
                return
            case "ignition_cycle":
                store.count_ignition_cycle()
            case "warm_up":
                store.count_warm_up()
            case "general_denominator":
                store.count_general_denominator()
        yield Counted(at.t_ns, moment)

    def _judge_memory(self, at: SamplePlace) -> Iterable[Happening]:
        """Judge the fault memory itself at the first sample of a driving cycle."""
        t_ns = at.t_ns
        changed = [DtcChanged(t_ns, dtc) for dtc in self._store.judge_memory(t_ns) if dtc.state]
        return list(self._frozen(changed, at))

    def _forget(self, _: None, __: SamplePlace) -> Iterable[Happening]:
        """Forget the conclusions so far."""
        self.adopt(self.limits)
        return ()

    def _electrical(self, result: TickResult, at: SamplePlace) -> Iterator[Happening]:
        """Take a result of a test without model."""
        yield from self._frozen(self.decisions.electrical(result, at.t_ns), at)

    def _judge_behind(self, result: BehindResult, at: SamplePlace) -> Iterable[Happening]:
        """Take a result of catalyst, downstream sensor or oxygen balance."""
        self._store.report(result.results)
        changes = self.decisions.behind(result.test, result.claim, at.t_ns)
        grams = result.capacity_g
        return list(self._frozen(changes, at, {} if grams is None else {CAPACITY: grams}))

    def _judge(self, item: Window, at: SamplePlace) -> Iterator[Happening]:
        """Take a full window; the facts of all those of a block are found together."""
        if self._facts is None:
            self._facts = iter(self.decisions.facts.of(self._windows))
        decide = self.decisions.cut if item.is_cut else self.decisions.window
        yield from self._frozen(decide(item, next(self._facts)), at)

    def _next_cycle(self, t_ns: int) -> Iterator[Happening]:
        seen = self.decisions.seen
        were_active = {dtc.code for dtc in self._store.active}
        changed = self._store.start_driving_cycle()
        self.adopt(self.limits)
        yield CycleStarted(t_ns, seen)
        for dtc in changed:
            if dtc.code in were_active:
                yield DtcChanged(t_ns, dtc)

    def _frozen(
        self,
        events: Iterable[WindowJudged | CutJudged | Change],
        at: SamplePlace,
        estimates: Mapping[str, float] = MappingProxyType({}),
    ) -> Iterator[WindowJudged | CutJudged | Change]:
        """Yield the events; with a code that fails, the signals of the sample are kept.

        estimates : what is kept beside them
        """
        for event in events:
            freeze(event, self._store, self._names, at.block.values[at.k], estimates)
            yield event


def freeze(
    event: object,
    store: DtcStore,
    names: Sequence[str],
    values: FloatArray,
    estimates: Mapping[str, float] = MappingProxyType({}),
) -> None:
    """Keep the known signals of a sample, (n_names,), if a code fails on it."""
    if isinstance(event, DtcChanged) and event.dtc.status & Status.TEST_FAILED:
        signals = {n: v for n, v in zip(names, values.tolist(), strict=True) if math.isfinite(v)}
        store.freeze(FreezeFrame(event.dtc.code, event.t_ns, {**signals, **estimates}))
