"""Cost of each stage from file to verdicts, for a full log and for many drives as tables.

The log is a simulated drive of the project's own ECU (200 frames/s that are needed) among synthetic
foreign traffic that fills a bus of 500 kbit/s (4,000 frames/s), as candump text and as BLF. It goes
through ``o2mon replay``, JSON and HTML included, and through the plain loop of python-can, cantools
and onnxruntime of ``replay_vs_plain_loop.py``: one that decodes only the messages it needs, and one
that decodes every message of the bus, with a database that describes the foreign ones, too. The
tables are simulated ten-minute drives held in memory, judged side by side by one process per core;
they are repeated to the number asked for. Times are seconds of processor time, medians of repeats;
the rate on several cores is also given by the clock on the wall.

    python -m benchmarks fleet_log [--seconds 600] [--drives 256] [--cores 2] [--repeats 3]
"""

import argparse
import json
import resource
import statistics
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.speed.batch import FIRST_SEED, FIRST_VEHICLE, PERIOD_NS, clocked
from benchmarks.speed.replay_vs_plain_loop import Bench, replay_plain
from monitor.base import config
from monitor.base.files.json_text import write_json
from monitor.base.types import SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import load_database
from monitor.grid.block_assembler import BlockAssembler
from monitor.pipeline import recordings
from monitor.pipeline.replay import Setup, replay, result_of, set_up
from monitor.pipeline.side_by_side import RecordingJudge
from monitor.report.model_facts import model_info
from monitor.report.page import write_report
from training.dyno import ecu
from training.dyno.simulation import Experiment, simulate
from training.recordings.can_log import FrameBlock, merge, write_log

FRAMES_PER_S, FOREIGN_IDS = 4_000, 60
TARGETS = {
    "candump": 500.0,
    "BLF": 500.0,
    "plain": 50.0,
    "samples_per_s": 1e6,
}
FLEET, DRIVE_S = 10_000, 600.0


def experiment(number: int, seconds: float) -> Experiment:
    return Experiment(vehicle=FIRST_VEHICLE + number, seed=FIRST_SEED + number, duration_s=seconds)


def loaded(seconds: float) -> FrameBlock:
    """Return a simulated drive among so much foreign traffic that the bus is full."""
    bus_map = ecu.own_bus()
    rng = np.random.default_rng(FIRST_SEED)
    own = ecu.frames(ecu.broadcast(simulate(experiment(0, seconds)), bus_map, rng, None, 0.0))
    span_ns = int(own.t_ns[-1] - own.t_ns[0])
    n = int(span_ns / 1e9 * FRAMES_PER_S) - len(own.t_ns)
    t_ns = own.t_ns[0] + np.linspace(0, span_ns, n).astype(np.int64) // 1000 * 1000
    foreign = FrameBlock(
        t_ns,
        rng.choice(np.arange(0x300, 0x300 + FOREIGN_IDS), n).astype(np.int64),
        np.zeros(n, dtype=np.bool_),
        np.full(n, 8, dtype=np.int64),
        rng.integers(0, 256, (n, 8), dtype=np.uint8),
    )
    return merge([own, foreign])


@contextmanager
def reading_clocked(seconds: dict[str, float]) -> Iterator[None]:
    """Add up what parsing, decoding and assembling take."""

    def clock(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = process_time()
            result = method(*args, **kwargs)
            seconds[name] = seconds.get(name, 0.0) + process_time() - start
            return result

        return timed

    read_blocks = recordings.read_blocks

    def parsed(*args: Any) -> Iterator[Any]:
        step = clock("parse", lambda blocks: next(blocks, None))
        blocks = read_blocks(*args)
        while (block := step(blocks)) is not None:
            yield block

    with ExitStack() as stack:
        stack.enter_context(patch.object(recordings, "read_blocks", parsed))
        for name, kind, method in (
            ("decode", BlockDecoder, "push"),
            ("assemble", BlockAssembler, "push"),
        ):
            timed = clock(name, getattr(kind, method))
            stack.enter_context(patch.object(kind, method, timed))
        yield


def judged(path: Path, setup: Setup) -> tuple[dict[str, Any], float]:
    """Return a log's entry, and the seconds until it stands in a JSON and in an HTML file."""
    start = process_time()
    entry, trace = replay(path, setup, trace=True)
    result = result_of([entry], setup)
    write_json(path.with_suffix(".json"), result)
    page = path.with_suffix(".html")
    write_report(page, result, [trace], title=path.name, model_info=model_info(setup))
    return entry, process_time() - start


def stages(path: Path, setup: Setup) -> dict[str, float]:
    """Return the seconds of each stage; the clocks themselves cost a little."""
    seconds: dict[str, float] = {}
    judging: dict[str, float] = {}
    with reading_clocked(seconds), clocked(judging):
        _, whole = judged(path, setup)
    found = seconds | judging
    return found | {"rest": whole - sum(found.values()), "whole, with clocks": whole}


def one_log(kind: str, path: Path, setup: Setup, repeats: int) -> dict[str, Any]:
    """Return what judging one log costs."""
    runs = [judged(path, setup) for _ in range(repeats)]
    split = [stages(path, setup) for _ in range(repeats)]
    entry = runs[0][0]
    if not entry["windows"]:
        raise AssertionError("no window was judged")
    drive_s = entry["samples"] * setup.model.card.period_ns / 1e9
    whole_s = statistics.median(seconds for _, seconds in runs)
    names = dict.fromkeys(name for each in split for name in each)
    return {
        "log": kind,
        "bytes": path.stat().st_size,
        "driving_s": drive_s,
        "replay_s": whole_s,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "times_real_time": drive_s / whole_s,
        "stages_s": {
            name: statistics.median(each.get(name, 0.0) for each in split) for name in names
        },
    }


def plain_loops(
    path: Path, setup: Setup, replays: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return what the plain loops cost beside the replay."""
    own, whole = (load_database(setup.bus_map.pairs[0][0]) for _ in range(2))
    whole.add_dbc_string(_foreign_dbc())
    found = []
    for what, database, everything in (
        ("decodes what it needs", own, False),
        ("decodes every message of the bus", whole, True),
    ):
        bench = Bench(path, setup, database, [], [])
        (seconds,) = replay_plain(bench, everything=everything)
        times = {each["log"]: seconds / each["replay_s"] for each in replays}
        drive_s = replays[0]["driving_s"]
        found.append({"plain loop": what, "times_real_time": drive_s / seconds, "ratio": times})
    return found


def _foreign_dbc() -> str:
    """Return a database of the foreign messages, four signals of two bytes in each."""
    signals = "".join(f' SG_ S{i} : {16 * i}|16@1+ (0.01,0) [0|655] "" X\n' for i in range(4))
    messages = "".join(f"BO_ {0x300 + i} Foreign{i}: 8 X\n{signals}\n" for i in range(FOREIGN_IDS))
    return f'VERSION ""\n\nBU_: X\n\n{messages}'


_BLOCKS: list[SampleBlock] = []
_NAMES: tuple[str, ...] = ()


def prepare(distinct: int) -> None:
    """Simulate drives, once in each process."""
    global _NAMES  # noqa: PLW0603  # a process of the pool has no other place for them
    bus_map = ecu.own_bus()
    for number in range(distinct):
        rng = np.random.default_rng(number)
        driven = simulate(experiment(number, DRIVE_S))
        sent = ecu.broadcast(driven, bus_map, rng, None, 0.0)
        _BLOCKS.append(ecu.samples(sent, bus_map, PERIOD_NS))
    _NAMES = bus_map.names


def tables(n: int) -> tuple[int, int, float, float, float]:
    """Return samples, windows, processor seconds, and when n drives began and were judged."""
    setup = set_up(None, (), config.load())
    blocks = [_BLOCKS[i % len(_BLOCKS)] for i in range(n)]
    judge = RecordingJudge(_NAMES, setup.model, setup.limits, setup.config, keep_banks=False)
    begin, start, windows = perf_counter(), process_time(), 0
    for first in range(0, n, 64):  # flat memory: what was judged is let go
        judged = judge.judge(blocks[first : first + 64])
        windows += sum(len(each.windows) for each in judged)
    samples = sum(len(block.t_ns) for block in blocks)
    return samples, windows, process_time() - start, begin, perf_counter()


def side_by_side(drives: int, cores: int, distinct: int = 32) -> dict[str, float]:
    """Return the rate at which tables are judged, by the clock and by processor time."""
    with ProcessPoolExecutor(
        cores, get_context("spawn"), initializer=prepare, initargs=(distinct,)
    ) as pool:
        list(pool.map(tables, [1] * cores))  # imports and simulations are over
        found = list(pool.map(tables, [drives // cores] * cores))
    samples = sum(each[0] for each in found)
    processor_s = sum(each[2] for each in found)
    wall_s = max(each[4] for each in found) - min(each[3] for each in found)
    return {
        "drives": drives // cores * cores,
        "samples": samples,
        "windows": sum(each[1] for each in found),
        "us_per_sample": 1e6 * processor_s / samples,
        "samples_per_s_by_the_clock": samples / wall_s,
        "samples_per_s_of_processors": cores * samples / processor_s,
        "fleet_minutes_by_the_clock": FLEET * wall_s / drives / 60,
        "fleet_minutes_of_processors": FLEET * processor_s / drives / cores / 60,
    }


def lines_of(log: dict[str, Any]) -> Iterator[str]:
    drive_s, whole_s = log["driving_s"], log["replay_s"]
    frames = FRAMES_PER_S * drive_s
    yield f"{log['log']}, {log['bytes'] / 1e6:.0f} MB, {drive_s:.0f} s of driving (synthetic)"
    for name, seconds in log["stages_s"].items():
        rate = f"{drive_s / seconds:10.0f} x" if seconds > 0 else ""
        yield f"  {name:24}{seconds:9.3f} s{1e9 * seconds / frames:9.1f} ns per frame{rate}"
    target = TARGETS[log["log"]]
    yield f"  o2mon replay {drive_s / whole_s:.0f} x real time, target {target:.0f}"
    yield f"  peak memory so far {log['peak_memory_mb']:.0f} MB"


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0, help="of driving in the log")
    parser.add_argument("--drives", type=int, default=256, help="of ten minutes, as tables")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args(argv)
    setup = set_up(None, (), config.load())
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        frames = loaded(args.seconds)
        candump, blf = (Path(folder) / f"loaded.{suffix}" for suffix in ("log", "blf"))
        for path in (candump, blf):
            write_log(path, frames)
        for kind, path in (("candump", candump), ("BLF", blf)):
            found.append(one_log(kind, path, setup, args.repeats))
            print("\n".join(lines_of(found[-1])), flush=True)
        plain = plain_loops(candump, setup, found[:1])
    print("\n".join(_plain_lines(plain)), flush=True)
    rates = side_by_side(args.drives, args.cores)
    print("\n".join(_table_lines(rates, args.cores)))
    if args.json:
        args.json.write_text(
            json.dumps({"logs": found, "plain": plain, "tables": rates}, indent=1) + "\n"
        )
    return 0


def _plain_lines(plain: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield f"plain loop on the candump log; target {TARGETS['plain']:.0f}"
    for each in plain:
        ratios = ", ".join(f"{name} {ratio:.0f}" for name, ratio in each["ratio"].items())
        yield (
            f"  {each['plain loop']}: {each['times_real_time']:.0f} x real time; "
            f"the replay is so many times as fast: {ratios}"
        )


def _table_lines(rates: dict[str, float], cores: int) -> Sequence[str]:
    return [
        f"{rates['drives']:.0f} simulated drives of ten minutes as tables, {cores} processes: "
        f"{rates['us_per_sample']:.2f} us of processor time per sample",
        f"  {rates['samples_per_s_by_the_clock']:,.0f} samples/s by the clock, "
        f"{rates['samples_per_s_of_processors']:,.0f} of {cores} processors; "
        f"target {TARGETS['samples_per_s']:,.0f}",
        f"  ten thousand such drives, extrapolated: {rates['fleet_minutes_by_the_clock']:.1f} "
        f"minutes by the clock, {rates['fleet_minutes_of_processors']:.1f} of processors",
    ]
