"""Kill processes on a fault memory with SIGKILL at random instants; nothing announced is lost.

Processes that drive a fault memory follow each other on one file; live loops run on a bus of three
drives with codes. After each kill the file must be sound and hold what was announced last, or what
was to be announced next.

python -m benchmarks kills [--cases 500] [--loops 30]
"""

import random
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.harness import fuzz_options
from benchmarks.outcome import Row, finish
from tests.helpers.memory.kills import kills, loop_kills


def main(argv: Sequence[str]) -> int:
    """Kill and report; an AssertionError tells what was lost."""
    options = fuzz_options(__name__, __doc__, 500, 50)
    options.add_argument("--loops", type=int, default=30, help="live loops that are killed as well")
    args = options.parse_args(argv)
    rng, begun_s = random.Random(args.seed), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        happened = kills(Path(folder) / "o2.db", args.cases, rng)
        rows: list[Row] = [{"killed": f"process, {w}", "n": n} for w, n in happened.items()]
        loops = 1 if args.smallest else args.loops
        told = loop_kills(Path(folder), loops, rng)
        rows.append({"killed": f"live loop of up to {told} events", "n": loops})
    events = ("fail", "pass", "clear", "cycle")
    missed = [f"no kill after {what}" for what in events if not happened[what]]
    return finish(args, [*rows, {"seconds": time.monotonic() - begun_s}], missed)
