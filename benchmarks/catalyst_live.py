"""What the tests behind the catalyst add to the live cost, at 4,000 frames/s.

A simulated drive with a downstream sensor is filled up with unneeded frames. The pipeline of the
live loop takes its frames one by one, in turn with and without the message of the downstream
sensor; reading the bus, which both sides do alike, is left out. Processor time, per second of the
drive; other work on the machine moves both sides.

    python benchmarks/catalyst_live.py [--repeats 5] [--frames-per-s 4000]
"""

import argparse
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time
from typing import Final

from repository import ROOT

from monitor.base import config
from monitor.base.types import Frame
from monitor.frames.logs import read_frames
from monitor.judge.catalyst import VOLTAGE
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.frames import FramePipeline
from monitor.report import replay

LOG: Final = ROOT / "replay_logs" / "healthy_downstream_micro_trips_v151_s153.blf"
FILLER_ID: Final = 0x600


def filled(frames: Sequence[Frame], frames_per_s: float) -> Iterator[Frame]:
    """Yield the frames with unneeded ones between them, evenly in time."""
    step_ns = round(1e9 / frames_per_s)
    next_ns = frames[0].t_ns
    for frame in frames:
        while next_ns < frame.t_ns:
            yield frame._replace(t_ns=next_ns, can_id=FILLER_ID, data=bytes(8))
            next_ns += step_ns
        next_ns += step_ns  # its own place on the bus
        yield frame


def seconds_of(frames: Sequence[Frame], setup: replay.Setup) -> tuple[float, int]:
    """Return the processor time of a drive, and how many segments behind the catalyst it judged."""
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, DtcStore())
    start = process_time()
    for frame in frames:
        for _ in pipeline.push(frame):
            pass
    entry = pipeline.monitor.catalyst.entry()
    return process_time() - start, entry["segments"] if entry else 0


def main() -> None:
    """Measure both sides in turn, and print their shares of a core."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--log", type=Path, default=LOG)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--frames-per-s", type=float, default=4000.0)
    args = parser.parse_args()
    setup = replay.set_up(None, (), config.load())
    own_id = setup.bus_map.channels[VOLTAGE].message.frame_id
    read = list(read_frames(args.log))
    drive_s = (read[-1].t_ns - read[0].t_ns) * 1e-9
    sides = {
        "without": list(filled([f for f in read if f.can_id != own_id], args.frames_per_s)),
        "with": list(filled(read, args.frames_per_s)),
    }
    shares: dict[str, list[float]] = {name: [] for name in sides}
    segments = dict.fromkeys(sides, 0)
    for _ in range(args.repeats):
        for name, frames in sides.items():
            seconds, segments[name] = seconds_of(frames, setup)
            shares[name].append(100.0 * seconds / drive_s)
    for name, frames in sides.items():
        print(
            f"{name:<8} downstream voltage: {len(frames) / drive_s:.0f} frames/s, "
            f"{segments[name]} segments judged, {statistics.median(shares[name]):.2f} % of a core "
            f"({min(shares[name]):.2f} to {max(shares[name]):.2f})"
        )
    more = [b - a for a, b in zip(shares["without"], shares["with"], strict=True)]
    low, high = min(more), max(more)
    print(f"more: {statistics.median(more):.2f} percentage points ({low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
