"""The cost of a live frame and sample by stage.

It takes the first ten minutes of a simulated recording of replay_logs and the shipped model. Frames
come in blocks of 20 ms, as the live loop takes them, samples one by one. A stage is timed alone, on
the output of the stage before it. Processor time, medians of the rounds; stages take turns.

python -m benchmarks streaming [--seconds 600] [--rounds 3]
"""

import math
from collections.abc import Iterator, Sequence
from itertools import groupby, takewhile
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks.measures import cpu_s, in_turn
from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.repository import REPLAY_LOGS
from monitor.base import config
from monitor.base.types import SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import block_of
from monitor.frames.logs import read_frames
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, log_samples
from monitor.grid.timeline import Timeline
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline import replay
from monitor.pipeline.events import Ticks, WindowJudged
from monitor.pipeline.monitor import Judge, SensorMonitor
from monitor.pipeline.names import needed_names

LOG = REPLAY_LOGS / "healthy_wltc_3b_v101_s101.blf"
BLOCK_NS = 20_000_000  # what the live loop lets gather


class StagedDrive:
    """One drive, cut into what each stage takes."""

    def __init__(self, path: Path, seconds: float) -> None:
        self.setup = replay.set_up(None, (), config.load())
        first_ns = next(iter(read_frames(path))).t_ns
        until_ns = first_ns + round(seconds * 1e9)
        frames = takewhile(lambda frame: frame.t_ns < until_ns, read_frames(path))
        own = {channel.message.frame_id for channel in self.setup.bus_map.channels.values()}
        needed = [frame for frame in frames if frame.can_id in own]
        self.n_frames = len(needed)
        self.blocks = [block_of(list(g)) for _, g in groupby(needed, lambda f: f.t_ns // BLOCK_NS)]
        self.samples = [p.part(k, k + 1) for p in self._decoded() for k in range(len(p.t_ns))]
        monitor = self.monitor()
        events = [event for sample in self.samples for event in monitor.push(sample)]
        self.n_windows = sum(isinstance(event, WindowJudged) for event in events)
        ticks = [event for event in events if isinstance(event, Ticks)]
        order = [monitor.names.index(name) for name in self.setup.model.card.input_names]
        self.inputs = [t.block.values[0, order] for t in ticks if math.isfinite(t.predicted[0])]

    def monitor(self) -> SensorMonitor:
        """Return a monitor that has seen nothing."""
        setup, store = self.setup, DtcStore(profile=self.setup.config.profile)
        store.start_driving_cycle()
        names = needed_names(setup.model.card, setup.bus_map.names)
        return SensorMonitor(Judge(names, setup.model, setup.config), setup.limits, store)

    def _decoded(self) -> Iterator[SampleBlock]:
        decoder = BlockDecoder(
            self.setup.bus_map, needed_names(self.setup.model.card, self.setup.bus_map.names)
        )
        assembler = BlockAssembler.of(decoder, self.setup.model.card.period_ns)
        blocks = Timeline(decoder).blocks(self.blocks)
        for part in log_samples(blocks, decoder, assembler):
            if not isinstance(part, Clearing):
                yield part

    def decode(self) -> float:
        """Return seconds per frame of decoding, checks and assembling."""
        return cpu_s(lambda: sum(1 for _ in self._decoded())) / self.n_frames

    def model(self) -> float:
        """Return seconds per model step."""
        self.setup.model.reset(self.inputs[0])
        step = self.setup.model.step
        return cpu_s(lambda: [step(u) for u in self.inputs]) / len(self.inputs)

    def all_samples(self) -> float:
        """Return seconds per sample, windows included."""
        push = self.monitor().push
        return cpu_s(lambda: [list(push(s)) for s in self.samples]) / len(self.samples)

    def sample(self, *, ends_window: bool) -> float:
        """Return seconds of a sample that completes a window, or of one that does not.

        Single samples are too short for the processor's clock, so this is by the wall clock.
        """
        push, took = self.monitor().push, list[float]()
        for sample in self.samples:
            start = perf_counter()
            events = list(push(sample))
            seconds = perf_counter() - start
            if any(isinstance(event, WindowJudged) for event in events) == ends_window:
                took.append(seconds)
        return median(took) if took else math.nan


def main(argv: Sequence[str]) -> int:
    """Print the cost of each stage."""
    options = BenchmarkOptions(__name__, __doc__, seconds=20.0, rounds=1)
    options.add_argument("--log", type=Path, default=LOG, help="a recording of frames")
    options.add_argument("--seconds", type=float, default=600.0, help="of the recording")
    options.add_argument("--rounds", type=int, default=3)
    args = options.parse_args(argv)
    drive = StagedDrive(args.log, args.seconds)
    stages = {
        "frame: decode, checks, assemble": drive.decode,
        "sample: model step": drive.model,
        "sample that completes no window": lambda: drive.sample(ends_window=False),
        "sample that completes a window": lambda: drive.sample(ends_window=True),
        "sample with its share of windows": drive.all_samples,
    }
    seconds = in_turn(stages, args.rounds)
    rows: list[Row] = [{"stage": stage, "us": 1e6 * each} for stage, each in seconds.items()]
    measured_on = {"frames": drive.n_frames, "samples": len(drive.samples)}
    return finish(args, [*rows, measured_on | {"windows": drive.n_windows}])
