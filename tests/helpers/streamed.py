"""What the streaming monitor makes of samples, to compare with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.base import config
from monitor.base.config import Config
from monitor.base.types import Sample, SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge.limits import Limits
from monitor.memory.dtc import DtcStore, Saved
from monitor.memory.obd_records import Counts
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.events import CycleStarted, DtcChanged, Event, Tick, WindowJudged
from monitor.pipeline.monitor import Monitor
from monitor.pipeline.side_by_side import Judged

PERIOD_NS = 100_000_000
SHIPPED = config.load()


@dataclass(frozen=True)
class Streamed:
    """What the streaming monitor makes of one recording."""

    ticks: list[Tick]
    windows: list[WindowJudged]
    changes: list[DtcChanged]
    cycles: list[CycleStarted]
    monitor: Monitor
    reference: Reference


def stream(
    block: SampleBlock,
    names: Sequence[str],
    model: Model,
    limits: Limits,
    settings: Config,
    store: DtcStore,
    reference: Reference | None = None,
    clearings: Sequence[Clearing] = (),
) -> Streamed:
    """Judge as ``replay`` does; with a reference the vehicle learns like one with a memory."""
    known = reference or Reference()
    own = limits.of_vehicle(known, settings.bias)
    monitor = Monitor(model, own, settings, names, store)
    rows = zip(block.index.tolist(), block.t_ns.tolist(), block.values, block.quality, strict=True)
    events: list[Event] = []
    for k, row in enumerate(rows):
        for each in clearings:
            if each.n_samples == k:
                events += [DtcChanged(each.t_ns, dtc) for dtc in store.clear()]
        for event in monitor.push(Sample(*row)):
            events.append(event)
            if reference is not None and isinstance(event, CycleStarted):
                known = known if event.seen is None else known.learn(event.seen, settings.bias)
                monitor.adopt(limits.of_vehicle(known, settings.bias))
    for each in clearings:
        if each.n_samples == len(block.t_ns):
            events += [DtcChanged(each.t_ns, dtc) for dtc in store.clear()]
    return Streamed(
        [event for event in events if isinstance(event, Tick)],
        [event for event in events if isinstance(event, WindowJudged)],
        [event for event in events if isinstance(event, DtcChanged)],
        [event for event in events if isinstance(event, CycleStarted)],
        monitor,
        known,
    )


def assert_same(streamed: Streamed, judged: Judged) -> None:
    assert [tick.conditions for tick in streamed.ticks] == list(
        map(tuple, judged.conditions.tolist())
    )
    assert [tick.enabled for tick in streamed.ticks] == judged.enabled.tolist()
    np.testing.assert_array_equal([tick.predicted for tick in streamed.ticks], judged.predicted)
    assert len(streamed.windows) == len(judged.windows)
    for a, b in zip(streamed.windows, judged.windows, strict=True):
        assert replace(a, window=b.window) == b  # mean, std, verdict, statistics: every digit
        for field in ("index", "t_start_ns", "t_end_ns", "measured", "predicted", "bank"):
            np.testing.assert_array_equal(getattr(a.window, field), getattr(b.window, field))
    assert streamed.changes == judged.changes
    assert streamed.cycles == judged.cycles
    assert streamed.reference == judged.reference
    assert streamed.monitor.limits == judged.limits
    assert streamed.monitor.interrupted_windows == judged.interrupted_windows
    assert streamed.monitor.store.active == judged.dtcs
    assert streamed.monitor.completed == judged.completed
    assert streamed.monitor.seen == judged.seen


def fresh() -> DtcStore:
    store = DtcStore()
    store.start_driving_cycle()
    return store


def kept(store: DtcStore) -> Saved:
    """Return what outlives the drive but distances and running times."""
    counts = store.counts
    numbers = counts.ignition_cycles, counts.general_denominator, counts.warm_ups_since_clear
    return replace(store.saved, counts=Counts(*numbers))
