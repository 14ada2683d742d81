"""The live loop on a played bus with a fault memory, as a program: ``FILE DRIVES``.

It prints, for every event that is stored, what the fault memory holds as JSON.
"""

import json
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from monitor.base import config
from monitor.bus.loop import Loop
from monitor.memory.dtc_store import Saved
from monitor.memory.store import Memory
from monitor.pipeline import replay
from monitor.pipeline.events import CutJudged, Event, Tick, WindowJudged
from tests.helpers.bus.played_bus import Ear, PlayedBus
from tests.helpers.logs.replays import frames_of

DRIVE_S = 60.0  # of a late sensor
PAUSE_NS = 600 * 10**9


class Announcer(Ear):
    """Tells what the fault memory holds once an event of the loop is stored."""

    loop: Loop

    def __init__(self, tell: Callable[[str], None]) -> None:
        super().__init__()
        self._tell = tell

    def push(self, event: Event) -> None:
        """Tell what the fault memory holds."""
        if not isinstance(event, Tick | WindowJudged | CutJudged):
            saved = self.loop.pipeline.monitor.store.saved
            self._tell(json.dumps({"told": held(saved)}))


def held(saved: Saved) -> list[Any]:
    """Return codes, counts and frames."""
    return [
        {d.code: int(d.status) for d in saved.dtcs},
        saved.counts.ignition_cycles,
        sorted(f.code for f in saved.freeze_frames),
        sorted(saved.permanent),
        {r.test: r.numerator for r in saved.ratios},
    ]


def run(path: Path, drives: int, tell: Callable[[str], None]) -> None:
    """Run the loop; ``tell`` gets a line for every event that is stored."""
    drive = frames_of("delay_rich_to_lean", DRIVE_S)
    length_ns = drive[-1].t_ns - drive[0].t_ns + PAUSE_NS
    later = (
        [frame._replace(t_ns=frame.t_ns + i * length_ns) for frame in drive] for i in range(drives)
    )
    bus = PlayedBus(chain.from_iterable(later))
    setup = replay.set_up(None, [], config.load())
    with closing(Memory(path, hold=True)) as memory, bus:
        announcer = Announcer(tell)
        loop = announcer.loop = Loop(
            bus,
            setup,
            memory=memory,
            attachments=[announcer],
            monotonic_s=lambda: bus.now_s,
            say=lambda line: print(line, file=sys.stderr),
        )
        bus.stop = loop.stop
        loop.run()


if __name__ == "__main__":
    run(Path(sys.argv[1]), int(sys.argv[2]), partial(print, flush=True))
