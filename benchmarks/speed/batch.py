"""The cost of judging whole recordings side by side, split by stage, and of a live bus.

Simulates WLTCs, holds them as tables in memory and judges them with the shipped model: all of them
by ``judge_all``, some of them tick by tick, and checks that both say the same. Figures
are medians of repeats, in microseconds of processor time per sample of the grid.

    python -m benchmarks batch [--drives 64] [--rows 64] [--streamed 2] [--repeats 3]
"""

import argparse
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from time import process_time
from types import GeneratorType
from typing import Any
from unittest.mock import patch

import numpy as np

from monitor.base import config
from monitor.base.config import Config
from monitor.base.types import SampleBlock
from monitor.judge.decision.decisions import Decisions
from monitor.judge.electrical.plausibility import ActivityTest, Plausibility
from monitor.judge.enable import Enable
from monitor.judge.limits import Limits
from monitor.judge.response.bank import Bank
from monitor.memory.cycles import Cycles
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import Model
from monitor.pipeline.events import BlockEvent, DtcChanged, WindowJudged
from monitor.pipeline.monitor import Judge, Monitor
from monitor.pipeline.replay import shipped_model
from monitor.pipeline.side_by_side import Judged, judge_all
from training.dyno import ecu
from training.dyno.simulation import Experiment, simulate

US = 1e6
PERIOD_NS = 100_000_000
TARGET_US = 3.0
FIRST_VEHICLE, FIRST_SEED = 2000, 2_000_000
STAGES: tuple[tuple[str, type, str], ...] = (
    ("driving cycles", Cycles, "push"),
    ("enable conditions", Enable, "push"),
    ("model", Model, "run_batch"),
    ("sensor bank", Bank, "push"),
    ("plausibility", Plausibility, "push"),
    ("activity", ActivityTest, "push"),
    ("decisions on samples", Decisions, "matured"),
    ("regression in windows", Decisions, "facts"),
    ("decisions on windows", Decisions, "window"),
)


def drive(number: int) -> tuple[SampleBlock, tuple[str, ...]]:
    """Return a healthy simulated WLTC on the grid, and its signals' names."""
    experiment = Experiment(vehicle=FIRST_VEHICLE + number, seed=FIRST_SEED + number)
    bus_map = ecu.own_bus()
    sent = ecu.broadcast(simulate(experiment), bus_map, np.random.default_rng(number), None, 0.0)
    return ecu.samples(sent, bus_map, PERIOD_NS), bus_map.names


@contextmanager
def clocked(seconds: dict[str, float]) -> Iterator[None]:
    """Add up what each stage takes while it runs inside the whole."""

    def clock(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = process_time()
            result = method(*args, **kwargs)
            if isinstance(result, GeneratorType):
                result = list(result)
            seconds[name] = seconds.get(name, 0.0) + process_time() - start
            return result

        return timed

    with ExitStack() as stack:
        for name, kind, method in STAGES:
            timed = clock(name, getattr(kind, method))
            stack.enter_context(patch.object(kind, method, timed))
        yield


def batch(
    blocks: Sequence[SampleBlock], names: Sequence[str], model: Model, settings: Config, rows: int
) -> tuple[list[Judged], dict[str, float]]:
    """Return the verdicts and the seconds of each stage and of the whole."""
    limits = Limits.from_card(model.card, settings, "shipped")
    seconds = dict.fromkeys((name for name, _, _ in STAGES), 0.0)
    start = process_time()
    with clocked(seconds):
        judged = judge_all(blocks, names, model, limits, settings, rows=rows)
    whole = process_time() - start
    seconds["rest"] = whole - sum(seconds.values())
    seconds["whole"] = whole
    return judged, seconds


def stream(
    block: SampleBlock, names: Sequence[str], model: Model, settings: Config
) -> tuple[list[BlockEvent], float]:
    """Return windows and codes of one recording, and the seconds."""
    store = DtcStore()
    store.start_driving_cycle()
    limits = Limits.from_card(model.card, settings, "shipped")
    push = Monitor(Judge(names, model, settings), limits, store).push
    ticks = [block.part(k, k + 1) for k in range(len(block.t_ns))]
    start = process_time()
    events = [event for tick in ticks for event in push(tick)]
    seconds = process_time() - start
    return [event for event in events if isinstance(event, WindowJudged | DtcChanged)], seconds


def check(streamed: Sequence[BlockEvent], judged: Judged) -> None:
    """Raise AssertionError unless both ways have said the same."""
    changes = [event for event in streamed if isinstance(event, DtcChanged)]
    verdicts = [e.statistics for e in streamed if isinstance(e, WindowJudged)]
    assert changes == judged.changes, "codes differ"
    assert verdicts == [w.statistics for w in judged.windows], "windows differ"


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--drives", type=int, default=64)
    parser.add_argument("--rows", type=int, default=64, help="recordings side by side")
    parser.add_argument("--streamed", type=int, default=2, help="drives to stream, too")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args(argv)
    simulated = [drive(number) for number in range(args.drives)]
    blocks, names = [block for block, _ in simulated], simulated[0][1]
    model, settings = Model.load(shipped_model()), config.load()
    n = sum(len(block.t_ns) for block in blocks)
    found: dict[str, list[float]] = {}
    streamed_us = []
    for _ in range(args.repeats):
        judged, seconds = batch(blocks, names, model, settings, args.rows)
        for name, each in seconds.items():
            found.setdefault(name, []).append(US * each / n)
        for block, own in list(zip(blocks, judged, strict=True))[: args.streamed]:
            events, took = stream(block, names, model, settings)
            check(events, own)
            streamed_us.append(US * took / len(block.t_ns))
    windows = sum(len(each.windows) for each in judged)
    print(
        f"{len(blocks)} simulated WLTCs, {n} samples, {windows} windows; {args.rows} side by side"
    )
    for name, values in found.items():
        print(f"{name:28}{statistics.median(values):8.3f} us per sample")
    whole, one = statistics.median(found["whole"]), statistics.median(streamed_us)
    print(f"target {TARGET_US:g}; per drive {whole * n / len(blocks) / 1e3:.0f} ms")
    print(f"block of one tick: {one:.2f} us per sample, {one / whole:.1f} times as much")
    return 0
