"""The way from a full log, and from many drives as tables, to verdicts, stage by stage.

The log is synthetic, a full bus of 500 kbit/s (4,000 frames/s), as candump text and as BLF; it is
judged as ``o2mon replay`` does, JSON and HTML included. The tables are simulated ten-minute drives
in memory, judged side by side by one process per core. Times are processor time, medians of the
rounds; the rate on several cores is also given by the clock on the wall.

python -m benchmarks fleet_log [--seconds 600] [--drives 256] [--cores 2] [--rounds 3]
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.measures import cpu_s, peak_mb
from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.speed import traffic
from monitor.base import config
from monitor.base.files.json_text import write_json
from monitor.base.types import SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.grid.block_assembler import BlockAssembler
from monitor.judge.response.bank import Bank
from monitor.model.step import Model
from monitor.pipeline import recordings
from monitor.pipeline.replay import Setup, replay, result_of, set_up
from monitor.report.model_facts import model_info
from monitor.report.page import write_report
from training.dyno import ecu
from training.dyno.simulation import simulate
from training.limits.judging import RecordingJudge
from training.recordings.files.can_log import write_log

TARGETS = {"candump": 500.0, "BLF": 500.0}  # times real time
DRIVE_S, PERIOD_NS = 600.0, 100_000_000
STAGES: tuple[tuple[str, Any, str], ...] = (
    ("read", recordings, "log_blocks"),
    ("decode", BlockDecoder, "push"),
    ("assemble", BlockAssembler, "push"),
    ("model", Model, "run_batch"),
    ("sensor bank", Bank, "push"),
)


@contextmanager
def clocked(seconds: dict[str, float]) -> Iterator[None]:
    """Add up what each stage takes while it runs inside the whole."""

    def clock(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = process_time()
            result = work(*args, **kwargs)
            seconds[name] = seconds.get(name, 0.0) + process_time() - start
            if isinstance(result, Iterator):
                return iter(clock(name, lambda: next(result, None)), None)
            return result

        return timed

    with ExitStack() as stack:
        for name, owner, attribute in STAGES:
            timed = clock(name, getattr(owner, attribute))
            stack.enter_context(patch.object(owner, attribute, timed))
        yield


def judge(path: Path, setup: Setup) -> dict[str, Any]:
    """Return a log's entry, after JSON and page are written."""
    entry, trace = replay(path, setup, trace=True)
    result = result_of([entry], setup)
    write_json(path.with_suffix(".json"), result)
    page = path.with_suffix(".html")
    write_report(page, result, [trace], model_info=model_info(setup))
    if not entry["windows"]:
        raise AssertionError("no window was judged")
    return entry


def one_log(kind: str, path: Path, setup: Setup, rounds: int) -> Iterator[Row]:
    """Yield the whole and the stages of judging one log; the clocks themselves cost a little."""
    entry = judge(path, setup)  # compiles
    drive_s = entry["samples"] * setup.model.card.period_ns / 1e9
    split: list[dict[str, float]] = []
    for _ in range(rounds):
        seconds: dict[str, float] = {"whole": cpu_s(lambda: judge(path, setup))}
        with clocked(seconds):
            judge(path, setup)
        seconds["rest"] = 2.0 * seconds["whole"] - sum(seconds.values())  # whole less all stages
        split.append(seconds)
    for stage in split[0]:
        took_s = median(each[stage] for each in split)
        yield {
            "log": kind,
            "drive_s": drive_s,
            "stage": stage,
            "seconds": took_s,
            "ns_per_frame": 1e9 * took_s / (traffic.FRAMES_PER_S * drive_s),
            "x real time": drive_s / took_s if took_s > 0.0 else None,
        }


_BLOCKS: list[SampleBlock] = []


def prepare(distinct: int) -> None:
    """Simulate drives, once in each process."""
    bus_map = ecu.own_bus()
    for number in range(distinct):
        driven = simulate(traffic.experiment(number, DRIVE_S))
        sent = ecu.broadcast(driven, bus_map, np.random.default_rng(number), None, 0.0)
        _BLOCKS.append(ecu.samples(sent, bus_map, PERIOD_NS))


def tables(n: int) -> tuple[int, int, float, float, float]:
    """Return samples, windows, processor seconds, and when n drives began and were judged."""
    setup = set_up(None, (), config.load())
    blocks = [_BLOCKS[i % len(_BLOCKS)] for i in range(n)]
    names = ecu.own_bus().names
    judge = RecordingJudge(names, setup.model, setup.limits, setup.config, keep_banks=False)
    begin, start, windows = perf_counter(), process_time(), 0
    for first in range(0, n, 64):  # flat memory: what was judged is let go
        windows += sum(len(each.windows) for each in judge.judge(blocks[first : first + 64]))
    samples = sum(len(block.t_ns) for block in blocks)
    return samples, windows, process_time() - start, begin, perf_counter()


def side_by_side(drives: int, cores: int) -> Row:
    """Return the rate at which tables are judged, by the clock and by processor time."""
    each = max(drives // cores, 1)
    spawned = get_context("spawn")
    with ProcessPoolExecutor(
        cores, spawned, initializer=prepare, initargs=(min(each, 32),)
    ) as pool:
        list(pool.map(tables, [1] * cores))  # imports and simulations are over
        found = list(pool.map(tables, [each] * cores))
    samples, windows, processor_s = (sum(one[i] for one in found) for i in range(3))
    wall_s = max(one[4] for one in found) - min(one[3] for one in found)
    return {
        "drives": each * cores,
        "windows": windows,
        "processes": cores,
        "us_per_sample": 1e6 * processor_s / samples,
        "samples/s, clock": samples / wall_s,
        "samples/s, processors": cores * samples / processor_s,
        "10,000 drives, min": 10_000 * wall_s / (each * cores) / 60.0,
    }


def main(argv: Sequence[str]) -> int:
    """Judge logs and tables; return 1 if a log is judged more slowly than wanted."""
    options = BenchmarkOptions(__name__, __doc__, seconds=30.0, drives=1, cores=1, rounds=1)
    options.add_argument("--seconds", type=float, default=600.0, help="of driving in the log")
    options.add_argument("--drives", type=int, default=256, help="of ten minutes, as tables")
    options.add_argument("--cores", type=int, default=2)
    options.add_argument("--rounds", type=int, default=3)
    args = options.parse_args(argv)
    setup, rows = set_up(None, (), config.load()), list[Row]()
    with tempfile.TemporaryDirectory() as folder:
        frames = traffic.full_bus(args.seconds)
        for kind, suffix in (("candump", "log"), ("BLF", "blf")):
            path = Path(folder) / f"full_bus.{suffix}"
            write_log(path, frames)
            rows += one_log(kind, path, setup, args.rounds)
    whole = {r["log"]: float(r["x real time"] or 0.0) for r in rows if r["stage"] == "whole"}
    rows += [{"peak_mb": peak_mb()}, side_by_side(args.drives, args.cores)]
    slow = [
        f"{kind} {times:.0f} times real time, wanted {TARGETS[kind]:g}"
        for kind, times in whole.items()
        if times < TARGETS[kind] and not args.smallest
    ]
    return finish(args, rows, slow)
