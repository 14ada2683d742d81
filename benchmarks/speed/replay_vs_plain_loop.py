"""``o2mon replay`` compared with a plain loop of python-can, cantools and onnxruntime.

Both read the same synthetic log: a simulated WLTC, 1800 s at 200 frames/s, as candump text. The
plain loop decodes only the needed messages, holds the last values for ever, runs the model every
period, and takes mean and standard deviation of 50 residuals. It checks and judges nothing; the
project does both. The two take turns. Figures are medians over the rounds in seconds of processor
time, which other work on the machine hardly changes.
"""

import argparse
import json
import os
import platform
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from time import process_time

import can
import numpy as np
from cantools.database.can import Database

from monitor.base import config
from monitor.base.types import FloatArray, Frame, Sample
from monitor.decode import checksum
from monitor.decode.bus_map import BusMap, load_database
from monitor.decode.decoder import Decoder
from monitor.decode.signal_map import Integrity
from monitor.frames.logs import read_frames
from monitor.grid.samples import FrameSamples
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import open_session
from monitor.pipeline import replay
from monitor.pipeline.events import WindowJudged
from monitor.pipeline.frames import FramePipeline, block_of
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment, simulate

SCHEMA = "o2bench.replay_vs_plain_loop/1"
N_FRAMES = 40_000  # 200 s of the log, for what is timed per frame
N_WINDOW = 50
US = 1e6

Timing = Callable[[], tuple[float, ...]]  # one run: seconds per unit, one figure per row


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    what: str
    unit: str  # "us" or "s"
    project: float
    plain: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        return self.plain / self.project if self.plain else None


@dataclass(frozen=True, slots=True)
class Bench:
    """What all timings work on."""

    path: Path
    setup: replay.Setup
    database: Database
    frames: list[Frame]  # of the first N_FRAMES, those the monitor needs
    samples: list[Sample]

    @classmethod
    def of(cls, path: Path, model: Path) -> "Bench":
        setup = replay.set_up(model, (), config.load())
        pipeline = _pipeline(setup)
        needed = {identifier for identifier, _ in pipeline.decoder.identifiers}
        frames = [f for f in islice(read_frames(path), N_FRAMES) if f.can_id in needed]
        database = load_database(setup.bus_map.pairs[0][0])
        recording, _ = replay.replay(path, setup)
        if not recording["windows"]:
            raise SystemExit(f"{model}: judges no window of {path.name}")
        return cls(path, setup, database, frames, list(_samples(path, setup)))


def _pipeline(setup: replay.Setup) -> FramePipeline:
    return FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, DtcStore())


def _stream(setup: replay.Setup) -> FrameSamples:
    names = _pipeline(setup).decoder.names
    return FrameSamples(setup.bus_map, names, setup.model.card.period_ns)


def _samples(path: Path, setup: replay.Setup) -> Iterator[Sample]:
    stream = _stream(setup)
    for frame in read_frames(path):
        yield from stream.push(frame)


def _unprotected(bus_map: BusMap) -> BusMap:
    channels = {n: replace(c, integrity=Integrity()) for n, c in bus_map.channels.items()}
    return replace(bus_map, channels=channels)


def read_project(bench: Bench) -> tuple[float, ...]:
    start = process_time()
    n = sum(1 for _ in islice(read_frames(bench.path), N_FRAMES))
    return ((process_time() - start) / n,)


def read_plain(bench: Bench) -> tuple[float, ...]:
    start = process_time()
    with can.LogReader(bench.path) as reader:
        n = sum(1 for _ in islice(reader, N_FRAMES))
    return ((process_time() - start) / n,)


def decode_project(bench: Bench, *, checks: bool) -> tuple[float, ...]:
    bus_map = bench.setup.bus_map if checks else _unprotected(bench.setup.bus_map)
    decoder = Decoder(bus_map, _pipeline(bench.setup).decoder.names)
    start = process_time()
    for frame in bench.frames:
        if not decoder.receive(frame):
            raise AssertionError("a sound frame was refused")
    return ((process_time() - start) / len(bench.frames),)


def decode_plain(bench: Bench, *, checks: bool) -> tuple[float, ...]:
    decode = bench.database.decode_message
    last: dict[int, object] = {}
    start = process_time()
    for _, can_id, _, data in bench.frames:
        values = decode(can_id, data)
        if not isinstance(values, dict):
            raise AssertionError("a message with signals is wanted")
        if checks:
            wanted = checksum.payload_checksum("crc8_sae_j1850_id", can_id, data, 7)
            if values["Checksum"] != wanted or values["AliveCounter"] == last.get(can_id):
                raise AssertionError("a sound frame was refused")
            last[can_id] = values["AliveCounter"]
    return ((process_time() - start) / len(bench.frames),)


def assemble_project(bench: Bench) -> tuple[float, ...]:
    push = _stream(bench.setup).push
    start = process_time()
    for frame in bench.frames:
        push(frame)
    return ((process_time() - start) / len(bench.frames),)


def _inputs(bench: Bench) -> list[FloatArray]:
    names = _pipeline(bench.setup).monitor.names
    order = [names.index(name) for name in bench.setup.model.card.input_names]
    rows = [sample.values[order] for sample in bench.samples]
    return [row for row in rows if np.isfinite(row).all()]


def step_project(bench: Bench) -> tuple[float, ...]:
    inputs, step = _inputs(bench), bench.setup.model.step
    start = process_time()
    for u in inputs:
        step(u)
    return ((process_time() - start) / len(inputs),)


def step_plain(bench: Bench) -> tuple[float, ...]:
    inputs = [np.array([u], np.float32) for u in _inputs(bench)]
    session = open_session(bench.setup.model_path.read_bytes(), "model")
    state = np.zeros((1, bench.setup.model.card.state.size), np.float32)
    start = process_time()
    for u in inputs:
        lambda_hat, state = session.run(["lambda_hat", "next_state"], {"u": u, "state": state})
        float(lambda_hat[0, 0])
    return ((process_time() - start) / len(inputs),)


def sample_project(bench: Bench) -> tuple[float, ...]:
    """Return seconds per sample that completes no window, and per one that does."""
    monitor = _pipeline(bench.setup).monitor
    took: dict[bool, list[float]] = {False: [], True: []}
    for block in [block_of([sample]) for sample in bench.samples]:
        start = process_time()
        events = list(monitor.push(block))
        seconds = process_time() - start
        took[any(isinstance(event, WindowJudged) for event in events)].append(seconds)
    usual, judged = (sum(took[key]) / len(took[key]) for key in (False, True))
    return usual, judged, judged - usual


def replay_project(bench: Bench) -> tuple[float, ...]:
    start = process_time()
    replay.replay(bench.path, bench.setup)
    return (process_time() - start,)


def replay_plain(bench: Bench, *, everything: bool = False) -> tuple[float, ...]:
    session = open_session(bench.setup.model_path.read_bytes(), "model")
    start = process_time()
    if not plain_loop(bench, session.run, everything=everything):
        raise AssertionError("no window was filled")
    return (process_time() - start,)


def plain_loop(
    bench: Bench, run: Callable[..., list[np.ndarray]], *, everything: bool = False
) -> list[tuple[float, float]]:
    """Return mean and standard deviation of each window of residuals.

    everything : decode all messages of the database, not only those that are needed
    """
    card, channels = bench.setup.model.card, bench.setup.bus_map.channels
    inputs = [channels[name].mapped.signal for name in card.input_names]
    output = channels[card.output.name].mapped.signal
    needed = {channels[n].message.frame_id for n in (*card.input_names, card.output.name)}
    if everything:
        needed = {message.frame_id for message in bench.database.messages}
    n_needed = len({*inputs, output})
    values: dict[str, float] = {}
    state = np.zeros((1, card.state.size), np.float32)
    residuals: list[float] = []
    windows: list[tuple[float, float]] = []
    period_s = card.period_ns / 1e9
    next_s = 0.0
    with can.LogReader(bench.path) as reader:
        for message in reader:
            while message.timestamp >= next_s:
                next_s = next_s + period_s if next_s else message.timestamp + period_s
                if len(values) < n_needed:
                    continue
                u = np.array([[values[name] for name in inputs]], np.float32)
                lambda_hat, state = run(["lambda_hat", "next_state"], {"u": u, "state": state})
                residuals.append(values[output] - float(lambda_hat[0, 0]))
                if len(residuals) == N_WINDOW:
                    windows.append((float(np.mean(residuals)), float(np.std(residuals))))
                    residuals.clear()
            if message.arbitration_id in needed:
                values.update(bench.database.decode_message(message.arbitration_id, message.data))  # type: ignore[arg-type]
    return windows


def simulate_project() -> tuple[float, ...]:
    start = process_time()
    simulate(Experiment())
    return (process_time() - start,)


def medians(timings: Sequence[Timing], rounds: int) -> list[tuple[float, ...]]:
    """Return the median figures of each timing; in every round each has its turn."""
    runs: list[list[tuple[float, ...]]] = [[] for _ in timings]
    for number in range(rounds):
        for timing, found in zip(timings, runs, strict=True):
            found.append(timing())
        print(f"round {number + 1} of {rounds}", file=sys.stderr)
    return [tuple(map(statistics.median, zip(*found, strict=True))) for found in runs]


def measure(bench: Bench, rounds: int) -> list[Row]:
    """Return the rows of the table."""
    simulate_project()  # compiles
    timings: list[Timing] = [
        lambda: read_project(bench),
        lambda: read_plain(bench),
        lambda: decode_project(bench, checks=False),
        lambda: decode_plain(bench, checks=False),
        lambda: decode_project(bench, checks=True),
        lambda: decode_plain(bench, checks=True),
        lambda: assemble_project(bench),
        lambda: step_project(bench),
        lambda: step_plain(bench),
        lambda: sample_project(bench),
        lambda: replay_project(bench),
        lambda: replay_plain(bench),
        simulate_project,
    ]
    found = [tuple(figures) for figures in medians(timings, rounds)]
    (read, plain_read, decode, plain_decode, checked, plain_checked, both, step, plain_step) = (
        figures[0] * US for figures in found[:9]
    )
    usual, judged, window = (seconds * US for seconds in found[9])
    whole, plain_whole, wltc = (figures[0] for figures in found[10:])
    t_ns = [bench.samples[0].t_ns, bench.samples[-1].t_ns]
    drive_s = (t_ns[1] - t_ns[0]) / 1e9
    speed = f"{drive_s / whole:.0f} x real time, plain {drive_s / plain_whole:.0f} x"
    return [
        Row("read a frame from candump text", "us", read, plain_read),
        Row("decode a frame, no checks", "us", decode, plain_decode),
        Row("decode a frame, CRC and counter", "us", checked, plain_checked),
        Row("decode and assemble a frame", "us", both),
        Row("model step", "us", step, plain_step),
        Row("sample, completes no window", "us", usual),
        Row("sample, completes a window", "us", judged),
        Row("window evaluation", "us", window),
        Row("replay of the whole log", "s", whole, plain_whole, speed),
        Row("simulation of a WLTC", "s", wltc),
    ]


def table(rows: Sequence[Row]) -> Iterator[str]:
    yield f"{'what':<34}{'project':>12}{'plain':>12}{'ratio':>8}"
    for row in rows:
        plain = f"{row.plain:9.2f} {row.unit:<2}" if row.plain else ""
        ratio = f"{row.ratio:.1f}" if row.ratio else ""
        yield f"{row.what:<34}{row.project:9.2f} {row.unit:<2}{plain:>12}{ratio:>8}  {row.note}"


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", type=Path, default=replay.shipped_model())
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args(argv)
    if not args.model.is_file():
        parser.error(f"{args.model}: no such model; give one with --model")
    versions = {name: version(name) for name in ("python-can", "cantools", "onnxruntime", "numpy")}
    with tempfile.TemporaryDirectory() as folder:
        path = write(Experiment(), Path(folder), "log")
        bench = Bench.of(path, args.model)
        print(
            f"synthetic log: {path.name}, simulated; Python {platform.python_version()}, ", end=""
        )
        print(", ".join(f"{name} {number}" for name, number in versions.items()))
        rows = measure(bench, args.rounds)
    print("\n".join(table(rows)))
    if args.json:
        report = {
            "schema": SCHEMA,
            "log": f"synthetic, {path.name}",
            "machine": f"{platform.machine()}, {os.cpu_count()} cores",
            "versions": {"python": platform.python_version()} | versions,
            "rows": [asdict(row) | {"ratio": row.ratio} for row in rows],
        }
        args.json.write_text(json.dumps(report, indent=1) + "\n")
    return 0
