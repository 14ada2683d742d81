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
from monitor.judge.decision.window_facts import Facts
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.limits import Limits
from monitor.judge.window import Window
from monitor.memory.cycles import Driven, Moment
from monitor.memory.dtc import Status
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.pipeline.events import Counted, CycleStarted, DtcChanged, Happening

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

        Cycles and windows come before the tick of their sample, the others behind it.
        """
        kept = self._store, self._names
        begins, self._has_begun = not self._has_begun, True
        if begins and (changed := self._judge_memory(block.t_ns.item(0))):  # behind the first tick
            yield 1, frozen(changed, *kept, block.values[0])
        self._facts, self._windows = None, [window for _, window in found.items]
        merged = sorted(
            ((k, step, each) for step, own in enumerate(found) for k, each in own),
            key=itemgetter(0, 1),
        )
        for k, step, each in merged:
            events = self._taken(each, block.t_ns.item(k))
            if isinstance(each, BehindResult):
                known = {} if each.capacity_g is None else {CAPACITY: each.capacity_g}
                events = list(frozen(events, *kept, block.values[k], known))
            elif events:
                events = frozen(events, *kept, block.values[k])
            if events:
                yield k + (step >= _AFTER_TICK), events

    def _taken(
        self, found: Driven | Moment | TickResult | BehindResult | Window | None, t_ns: int
    ) -> Iterable[Happening]:
        """Take one finding; return what it causes."""
        match found:
            case Driven():
                self._store.drive(*found)
            case None:
                self.adopt(self.limits)
            case TickResult():
                return self.decisions.electrical(found, t_ns)
            case BehindResult():
                self._store.report(found.results)
                return self.decisions.behind(found.test, found.claim, t_ns)
            case Window():  # the facts of all those of a block are found together
                if self._facts is None:
                    self._facts = iter(self.decisions.facts.of(self._windows))
                return self.decisions.window(found, next(self._facts))
            case _:
                return self._count(found, t_ns)
        return ()

    def _count(self, moment: Moment, t_ns: int) -> Iterator[Happening]:
        """Let the fault memory count; begin the next driving cycle."""
        store = self._store
        match moment:
            case "driving_cycle":
                yield from self._next_cycle(t_ns)
                yield from self._judge_memory(t_ns)
                return
            case "ignition_cycle":
                store.counts.ignition_cycles += 1
            case "warm_up":
                store.count_warm_up()
            case "general_denominator":
                store.count_general_denominator()
        yield Counted(t_ns, moment)

    def _judge_memory(self, t_ns: int) -> list[DtcChanged]:
        """Judge the fault memory itself at the first sample of a driving cycle."""
        return [DtcChanged(t_ns, dtc) for dtc in self._store.judge_memory(t_ns) if dtc.state]

    def _next_cycle(self, t_ns: int) -> Iterator[Happening]:
        seen = self.decisions.seen
        were_active = {dtc.code for dtc in self._store.active}
        changed = self._store.start_driving_cycle()
        self.adopt(self.limits)
        yield CycleStarted(t_ns, seen)
        for dtc in changed:
            if dtc.code in were_active:
                yield DtcChanged(t_ns, dtc)


def frozen(
    events: Iterable[_Found],
    store: DtcStore,
    names: Sequence[str],
    values: FloatArray,
    estimates: Mapping[str, float] = MappingProxyType({}),
) -> Iterator[_Found]:
    """Yield events; with a code that fails, the known signals of the sample, (n_names,), are kept.

    estimates : what is kept beside them
    """
    for event in events:
        if isinstance(event, DtcChanged) and event.dtc.status & Status.TEST_FAILED:
            known = zip(names, values.tolist(), strict=True)
            signals = {name: value for name, value in known if math.isfinite(value)}
            store.freeze(FreezeFrame(event.dtc.code, event.t_ns, {**signals, **estimates}))
        yield event
