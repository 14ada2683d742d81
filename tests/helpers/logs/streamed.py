"""A recording through one monitor, block by block, to compare with."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat

import numpy as np

from monitor.base import config
from monitor.base.config import Config
from monitor.base.types import SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge.limits import Limits
from monitor.memory.dtc_store import DtcStore
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.events import (
    BlockEvent,
    CutJudged,
    CycleStarted,
    DtcChanged,
    Tick,
    Ticks,
    WindowJudged,
)
from monitor.pipeline.monitor import Judge, SensorMonitor
from training.limits.judging import Judged

PERIOD_NS = 100_000_000
SHIPPED = config.load()
# short times, so that short recordings reach windows, verdicts and codes
SHORT = replace(
    SHIPPED,
    window=replace(SHIPPED.window, n_samples=10),
    enable=replace(
        SHIPPED.enable, model_settle_samples=3, fuel_cut_recovery_s=0.3, purge_recovery_s=0.2
    ),
    cycles=replace(
        SHIPPED.cycles,
        engine_off_s=4.0,
        silent_s=1.0,
        start_s=0.5,
        denominator_run_s=6.0,
        denominator_moving_s=4.0,
        denominator_idle_s=0.5,
    ),
    plausibility=replace(
        SHIPPED.plausibility, stuck_s=1.0, start_patience_s=1.0, not_ready_s=1.0, stuck_range=0.01
    ),
    debounce=replace(SHIPPED.debounce, tick_fail_s=0.4, tick_pass_s=0.9),
    bias=replace(SHIPPED.bias, reference_windows=2),
)


@dataclass(frozen=True)
class Streamed:
    """What one monitor makes of one recording."""

    ticks: list[Tick]
    windows: list[WindowJudged]
    cuts: list[CutJudged]
    changes: list[DtcChanged]
    cycles: list[CycleStarted]
    monitor: SensorMonitor
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
    sizes: Iterable[int] = repeat(1),
) -> Streamed:
    """Judge as ``replay`` does; with a reference the vehicle learns like one with a memory.

    sizes : samples of each block, by default one as on a live bus
    """
    known = reference or Reference()
    own = limits.of_vehicle(known, settings.bias)
    monitor = SensorMonitor(Judge(names, model, settings), own, store)
    events: list[BlockEvent] = []
    k, rest = 0, iter(sizes)
    while k < len(block.t_ns):
        for each in clearings:
            if each.n_samples == k:
                events += monitor.clear(each.t_ns)
        ends = [each.n_samples for each in clearings if each.n_samples > k]
        end = min(k + next(rest, len(block.t_ns)), *ends, len(block.t_ns))
        for event in monitor.push(block.part(k, end)):
            events.append(event)
            if reference is not None and isinstance(event, CycleStarted):
                known = known if event.seen is None else known.learn(event.seen, settings.bias)
                monitor.adopt(limits.of_vehicle(known, settings.bias))
        k = end
    for each in clearings:
        if each.n_samples == len(block.t_ns):
            events += monitor.clear(each.t_ns)
    return Streamed(
        ticks=[tick for event in events if isinstance(event, Ticks) for tick in event.each()],
        windows=[event for event in events if isinstance(event, WindowJudged)],
        cuts=[event for event in events if isinstance(event, CutJudged)],
        changes=[event for event in events if isinstance(event, DtcChanged)],
        cycles=[event for event in events if isinstance(event, CycleStarted)],
        monitor=monitor,
        reference=known,
    )


def assert_same(streamed: Streamed, judged: Judged) -> None:
    assert [tick.conditions for tick in streamed.ticks] == list(
        map(tuple, judged.conditions.tolist())
    )
    assert [tick.enabled for tick in streamed.ticks] == judged.enabled.tolist()
    np.testing.assert_array_equal([tick.predicted for tick in streamed.ticks], judged.predicted)
    assert len(streamed.cuts) == len(judged.cuts)
    assert len(streamed.windows) == len(judged.windows)
    pairs = (streamed.windows, judged.windows), (streamed.cuts, judged.cuts)
    for a, b in chain.from_iterable(zip(*pair, strict=True) for pair in pairs):
        assert replace(a, window=b.window) == b  # mean, std, verdict, statistics: every digit
        for field in ("index", "t_start_ns", "t_end_ns", "measured", "predicted", "bank"):
            np.testing.assert_array_equal(getattr(a.window, field), getattr(b.window, field))
    assert streamed.changes == judged.changes
    assert streamed.cycles == judged.cycles
    assert streamed.reference == judged.reference
    assert streamed.monitor.limits == judged.limits
    assert streamed.monitor.windows.discarded == judged.interrupted_windows
    assert streamed.monitor.store.active == judged.dtcs
    assert streamed.monitor.decisions.completed == judged.completed
    assert streamed.monitor.decisions.seen == judged.seen


def fresh() -> DtcStore:
    store = DtcStore()
    store.start_driving_cycle()
    return store
