"""Kills processes on a fault memory with SIGKILL at random instants; nothing announced is lost.

Processes that drive a fault memory follow each other on one file; live loops run on a bus of three
drives with codes. After each kill the file must be sound and hold what was announced last, or what
was to be announced next.

    python -m benchmarks kills --kills 500 --loops 30
"""

import random
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.fuzz_options import fuzz_parser
from tests.helpers.kills import kills, loop_kills


def main(argv: Sequence[str]) -> int:
    """Kill and report; an AssertionError tells what was lost."""
    parser = fuzz_parser(__doc__, "kills", 500)
    parser.add_argument("--loops", type=int, default=30, help="live loops that are killed as well")
    args = parser.parse_args(argv)
    rng, begun_s = random.Random(args.seed), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        happened = kills(Path(folder) / "o2.db", args.kills, rng)
        counts = ", ".join(f"{what} {n}" for what, n in happened.most_common())
        print(f"{args.kills} kills, nothing lost: {counts}", flush=True)
        told = loop_kills(Path(folder), args.loops, rng)
    print(f"{args.loops} live loops, each of up to {told} events: nothing lost")
    print(f"{time.monotonic() - begun_s:.0f} s")
    return 0
