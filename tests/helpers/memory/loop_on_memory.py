"""The live loop on a played bus with a fault memory, as a program: ``FILE DRIVES [FULL|DRIVEN]``.

It prints ``ready``, for every event that is stored what the fault memory holds as JSON, every line
that the loop says, and in the end the codes. With FULL the file system of the memory is filled up
before the first frame. With DRIVEN it is one healthy drive, of which it prints with each sample for
how many seconds the engine has run.
"""

import json
import sys
from contextlib import closing, suppress
from itertools import chain
from pathlib import Path
from typing import Any

from monitor.base import config
from monitor.bus.attachment import Attachment
from monitor.bus.loop import Loop
from monitor.frames.logs import read_frames
from monitor.memory.dtc_store import Saved
from monitor.memory.store import Memory
from monitor.pipeline import replay
from monitor.pipeline.events import CutJudged, Event, Tick, WindowJudged
from tests.helpers.bus.played_bus import Ear, PlayedBus

DRIVE = 200 * 60  # frames, a minute of a late sensor
PAUSE_NS = 600 * 10**9


class Announcer(Ear):
    """Prints what the loop tells once it is stored."""

    loop: Loop

    def push(self, event: Event) -> None:
        """Print what the fault memory holds."""
        if not isinstance(event, Tick | WindowJudged | CutJudged):
            saved = self.loop.pipeline.monitor.store.saved
            print(json.dumps({"told": held(saved)}), flush=True)


class Odometer(Announcer):
    """Prints what was driven, stored or not."""

    def push(self, event: Event) -> None:
        """Print the engine's running time."""
        run_s = self.loop.pipeline.monitor.store.counts.engine_run_since_clear_s
        print(json.dumps({"driven_s": run_s}), flush=True)


def held(saved: Saved) -> list[Any]:
    """Return codes, counts and frames."""
    return [
        {d.code: int(d.status) for d in saved.dtcs},
        saved.counts.ignition_cycles,
        sorted(f.code for f in saved.freeze_frames),
        sorted(saved.permanent),
        {r.test: r.numerator for r in saved.ratios},
    ]


def fill(folder: Path) -> None:
    """Use up a file system."""
    with suppress(OSError), (folder / "filler").open("wb", buffering=0) as file:
        while file.write(bytes(512)) == 512:
            pass


def main(path: Path, drives: int, announcer: Announcer, *, is_full: bool) -> None:
    """Run the loop."""
    is_healthy = isinstance(announcer, Odometer)
    (log,) = Path("replay_logs").glob(f"{'healthy_micro' if is_healthy else 'delay_rich_to'}_*.blf")
    drive = list(read_frames(log))[: None if is_healthy else DRIVE]
    length_ns = drive[-1].t_ns - drive[0].t_ns + PAUSE_NS
    later = (
        [frame._replace(t_ns=frame.t_ns + i * length_ns) for frame in drive] for i in range(drives)
    )
    bus = PlayedBus(chain.from_iterable(later))
    setup = replay.set_up(None, [], config.load())
    with closing(Memory(path, hold=True)) as memory, bus:
        hooked: list[Attachment] = [announcer]
        loop = announcer.loop = Loop(
            bus,
            setup,
            memory=memory,
            attachments=hooked,
            monotonic_s=lambda: bus.now_s,
            say=lambda line: print(line, flush=True),
        )
        bus.stop = loop.stop
        if is_full:
            fill(path.parent)
        print("ready", flush=True)
        loop.run()
        codes = {d.code: d.state for d in loop.pipeline.monitor.store.active}
        print(json.dumps({"codes": codes, "errors": loop.health.memory_errors}), flush=True)


if __name__ == "__main__":
    told = Odometer() if "DRIVEN" in sys.argv else Announcer()
    main(Path(sys.argv[1]), int(sys.argv[2]), told, is_full="FULL" in sys.argv)
