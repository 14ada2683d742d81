"""Events of a monitor: ticks, driving cycles, windows, codes and counts."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from monitor.base.types import BoolArray, FloatArray, Sample, SampleBlock
from monitor.judge.findings import Change, Counted, CutJudged, DtcChanged, RuleOff, WindowJudged
from monitor.memory.reference import Seen

__all__ = [
    "BlockEvent",
    "Change",
    "Counted",
    "CutJudged",
    "CycleStarted",
    "DtcChanged",
    "Event",
    "Happening",
    "RuleOff",
    "Tick",
    "Ticks",
    "WindowJudged",
    "singly",
]


class Tick(NamedTuple):
    """One sample went through the model."""

    sample: Sample
    predicted: float  # output's unit, NaN while an input is not valid
    conditions: tuple[bool, ...]  # in the order of enable.CONDITIONS
    enabled: bool


class Ticks(NamedTuple):
    """Samples in a row went through the model, and nothing else happened before the last."""

    block: SampleBlock
    predicted: FloatArray  # (n,) output's unit, NaN while an input is not valid
    conditions: BoolArray  # (n, n_conditions) in the order of enable.CONDITIONS
    enabled: BoolArray  # (n,)

    def each(self) -> Iterator[Tick]:
        """Yield the samples one by one."""
        block = self.block
        samples = map(
            Sample, block.index.tolist(), block.t_ns.tolist(), block.values, block.quality
        )
        conditions = map(tuple, self.conditions.tolist())
        return map(Tick, samples, self.predicted.tolist(), conditions, self.enabled.tolist())


class CycleStarted(NamedTuple):
    """The next driving cycle begins; the changes of codes that it brings follow."""

    t_ns: int
    seen: Seen | None  # for the vehicle's reference to learn, of the driving cycle before


Happening = CycleStarted | WindowJudged | CutJudged | DtcChanged | Counted | RuleOff
BlockEvent = Ticks | Happening  # what a monitor yields
Event = Tick | Happening  # the same, sample by sample


def singly(event: BlockEvent) -> Iterable[Event]:
    """Return an event sample by sample."""
    return event.each() if isinstance(event, Ticks) else (event,)
