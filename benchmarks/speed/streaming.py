"""The cost of a live sample and frame, split by stage, beside its targets.

It replays the first ten minutes of a simulated recording of replay_logs with the shipped model. A
stage is timed alone, over these, on the output of the stage before it. Figures are medians of
repeats in microseconds of processor time; the stages take turns in every repeat. It takes 15 s.

    python -m benchmarks streaming [--log LOG] [--seconds 600] [--repeats 3]
"""

import argparse
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks.repository import ROOT
from monitor.base import config
from monitor.base.types import FloatArray, Frame, SampleBlock
from monitor.frames.logs import read_frames
from monitor.grid.samples import FrameSamples
from monitor.judge import enable
from monitor.judge.electrical.plausibility import Plausibility
from monitor.judge.residual import oriented
from monitor.judge.response.bank import Bank, Spans, build
from monitor.judge.response.claims import Noise
from monitor.judge.response.rule import ResponseRule
from monitor.judge.window import Window
from monitor.memory.cycles import Cycles
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline import replay
from monitor.pipeline.events import Ticks, WindowJudged
from monitor.pipeline.frames import FramePipeline

LOG = ROOT / "replay_logs" / "healthy_wltc_3b_v101_s101.blf"
US = 1e6
TARGETS_US = {"decode and assemble": 1.2, "whole sample": 150.0, "whole window": 200.0}

Stage = Callable[[], float]  # one run: seconds per unit


@dataclass(frozen=True, slots=True)
class Bench:
    """One drive, cut into what each stage takes."""

    setup: replay.Setup
    frames: list[Frame]  # those that carry a needed signal
    samples: list[SampleBlock]  # of one tick each
    inputs: list[FloatArray]  # of the model, where all are valid
    predicted: list[float]  # output's unit
    windows: list[Window]

    @classmethod
    def of(cls, path: Path, seconds: float) -> "Bench":
        setup = replay.set_up(None, (), config.load())
        pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, DtcStore())
        needed = set(pipeline.decoder.identifiers)
        first = next(iter(read_frames(path)))
        until_ns = first.t_ns + round(seconds * 1e9)
        part = takewhile(lambda frame: frame.t_ns < until_ns, read_frames(path))
        frames = [f for f in part if (f.can_id, f.is_extended) in needed]
        events = [event for frame in frames for event in pipeline.push(frame)]
        ticks = [event for event in events if isinstance(event, Ticks)]
        order = [pipeline.monitor.names.index(name) for name in setup.model.card.input_names]
        return cls(
            setup=setup,
            frames=frames,
            samples=[tick.block for tick in ticks],
            inputs=[t.block.values[0, order] for t in ticks if math.isfinite(t.predicted[0])],
            predicted=[t.predicted.item(0) for t in ticks if math.isfinite(t.predicted[0])],
            windows=[event.window for event in events if isinstance(event, WindowJudged)],
        )

    def pipeline(self) -> FramePipeline:
        setup = self.setup
        return FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, DtcStore())

    @property
    def period_s(self) -> float:
        return self.setup.model.card.period_ns * 1e-9

    def decode(self) -> float:
        return _per_call(self.pipeline().decoder.receive, self.frames)

    def assemble(self) -> float:
        """Return the cost of time and ticks; adding the values is a part of decoding them."""
        return _per_call(self.pipeline().assembler.advance, [f.t_ns for f in self.frames])

    def decode_and_assemble(self) -> float:
        decoder = self.pipeline().decoder
        samples = FrameSamples(self.setup.bus_map, decoder.names, self.setup.model.card.period_ns)
        return _per_call(samples.push, self.frames)

    def cycles(self) -> float:
        monitor, config = self.pipeline().monitor, self.setup.config
        cycles = Cycles(
            config.cycles,
            config.profile,
            monitor.names,
            monitor.output,
            config.plausibility.engine_running_rpm,
        )
        return _per_call(cycles.push, self.samples)

    def conditions(self) -> float:
        names = self.pipeline().monitor.names
        push = enable.Enable.of(self.setup.config.enable, names, self.setup.model.card).push
        return _per_call(push, [block.values for block in self.samples])

    def plausibility(self) -> float:
        names, output = self.pipeline().monitor.names, self.setup.model.card.output.name
        tests = Plausibility(self.setup.config.plausibility, names, output, self.period_s)
        return _per_call(lambda block: tests.push(block.values, block.quality), self.samples)

    def model(self) -> float:
        self.setup.model.reset(self.inputs[0])
        return _per_call(self.setup.model.step, self.inputs)

    def bank(self) -> float:
        bank = Bank(build(self.setup.config.response), self.period_s)
        values = oriented(np.array(self.predicted), self.setup.model.card.transform)
        state, span = bank.begin(values.item(0)), Spans([0], [0], [1])
        start = process_time()
        for k in range(len(values)):
            _, (state,) = bank.push(values[np.newaxis, k : k + 1], [1], [state], span)
        return (process_time() - start) / len(values)

    def response(self) -> float:
        """Return the response rule's share of a window."""
        limits, response = self.setup.limits, self.setup.config.response
        bank = build(response)
        rule = ResponseRule(
            response,
            bank,
            Noise(limits.noise, limits.noise_memory),
            limits.excitation,
            self.period_s,
        )
        pairs = [(1.0 / window.measured[np.newaxis], [window.bank]) for window in self.windows]
        ignore = np.zeros(1, dtype=np.bool_)
        start = process_time()
        for measured, read in pairs:
            rule.judge(measured, read, ignore)
        return (process_time() - start) / len(pairs)

    def sample_and_window(self) -> tuple[float, float]:
        """Return seconds of a sample that completes no window, and what one adds to it.

        Single samples are too short for the processor's clock, so this is by the wall clock, and
        the median, which other work on the machine hardly moves.
        """
        push = self.pipeline().monitor.push
        took: dict[bool, list[float]] = {False: [], True: []}
        for sample in self.samples:
            start = perf_counter()
            events = list(push(sample))
            seconds = perf_counter() - start
            took[any(type(event) is WindowJudged for event in events)].append(seconds)
        usual, judged = (statistics.median(took[key]) for key in (False, True))
        return usual, judged - usual

    def all_samples(self) -> float:
        """Return seconds per sample, windows included."""
        push = self.pipeline().monitor.push
        start = process_time()
        for sample in self.samples:
            for _ in push(sample):
                pass
        return (process_time() - start) / len(self.samples)


def _per_call(call: Callable[[Any], object], arguments: Sequence[Any]) -> float:
    start = process_time()
    for argument in arguments:
        call(argument)
    return (process_time() - start) / len(arguments)


def measure(bench: Bench, repeats: int) -> dict[str, float]:
    """Return the median microseconds of each stage."""
    stages: dict[str, Stage] = {
        "decode": bench.decode,
        "assemble": bench.assemble,
        "decode and assemble": bench.decode_and_assemble,
        "driving cycles": bench.cycles,
        "enable conditions": bench.conditions,
        "plausibility": bench.plausibility,
        "model step": bench.model,
        "sensor bank": bench.bank,
        "sample with its share of windows": bench.all_samples,
        "response rule": bench.response,
    }
    found: dict[str, list[float]] = {name: [] for name in stages}
    whole: list[tuple[float, float]] = []
    for _ in range(repeats):
        for name, stage in stages.items():
            found[name].append(stage())
        whole.append(bench.sample_and_window())
    figures = {name: US * statistics.median(seconds) for name, seconds in found.items()}
    sample, window = (US * float(np.median(column)) for column in zip(*whole, strict=True))
    figures |= {"whole sample": sample, "whole window": window}
    parts = ("driving cycles", "enable conditions", "plausibility", "model step", "sensor bank")
    figures["events, debounce, filling of windows"] = sample - sum(figures[name] for name in parts)
    return figures


TABLE = (
    ("frame that carries a needed signal", ("decode", "assemble", "decode and assemble")),
    (
        "sample",
        (
            "driving cycles",
            "enable conditions",
            "plausibility",
            "model step",
            "sensor bank",
            "events, debounce, filling of windows",
            "whole sample",
            "sample with its share of windows",
        ),
    ),
    ("window", ("response rule", "whole window")),
)


def table(figures: dict[str, float]) -> list[str]:
    """Return the lines to print."""
    lines = [f"{'per':36}{'stage':40}{'us':>8}{'target':>9}"]
    for unit, stages in TABLE:
        for stage in stages:
            target = TARGETS_US.get(stage)
            wanted = "" if target is None else f"{target:g}"
            lines.append(f"{unit:36}{stage:40}{figures[stage]:8.2f}{wanted:>9}")
    return lines


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--log", type=Path, default=LOG, help="a recording of frames")
    parser.add_argument(
        "--seconds", type=float, default=600.0, help="of the recording, from its begin"
    )
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args(argv)
    bench = Bench.of(args.log, args.seconds)
    if not bench.windows:
        parser.error(f"{args.log}: no window in it was judged")
    print(
        f"{args.log.name}: {len(bench.frames)} needed frames, {len(bench.samples)} samples, "
        f"{len(bench.windows)} windows; median of {args.repeats}"
    )
    print("\n".join(table(measure(bench, args.repeats))))
    return 0
