"""Damage the files of a fault memory in random ways and start on them: nothing silent or fatal.

Run with: python -m benchmarks fuzz_memory [--damages 10000] [--seed 1]
"""

import random
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.fuzz_options import fuzz_parser
from tests.helpers.memory_damage import attacks, contents, memories, outcome

SLOW_S = 5.0


def main(argv: Sequence[str]) -> int:
    """Print how often each outcome came; return 1 if one of them is an error."""
    parser = fuzz_parser(__doc__, "damages", 10_000)
    args = parser.parse_args(argv)
    draw, counts, slowest_s = random.Random(args.seed), Counter[str](), 0.0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "folder"
        for name, files in memories(Path(temporary)).items():
            wholes = contents(files, folder)
            for changed, victims in attacks(files, draw, args.damages // 2):
                began_s = time.monotonic()
                found = outcome(changed, folder, wholes)
                slowest_s = max(slowest_s, time.monotonic() - began_s)
                counts[found] += 1
                if found.isupper() or found.split()[0].isupper():
                    print(f"{name}, damage in {', '.join(sorted(victims))}: {found}")
    for found, n in counts.most_common():
        print(f"{n:6}  {found}")
    print(f"slowest start {slowest_s:.2f} s")
    bad = sum(n for found, n in counts.items() if found.split()[0].isupper())
    return int(bad > 0 or slowest_s > SLOW_S)
