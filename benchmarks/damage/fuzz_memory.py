"""Damage the files of a fault memory in random ways and start on them: nothing silent or fatal.

python -m benchmarks fuzz_memory [--cases 10000]
"""

import random
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.harness import Outcomes, fuzz_options
from benchmarks.outcome import finish
from tests.helpers.memory_damage import attacks, contents, memories, outcome

SLOW_S = 5.0


def main(argv: Sequence[str]) -> int:
    """Count the outcomes; return 1 if one of them is an error."""
    args = fuzz_options(__name__, __doc__, 10_000, 100).parse_args(argv)
    draw, outcomes = random.Random(args.seed), Outcomes()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "folder"
        for name, files in memories(Path(temporary)).items():
            wholes = contents(files, folder)
            for changed, victims in attacks(files, draw, args.cases // 2):
                outcomes.add(
                    f"{name}, damage in {', '.join(sorted(victims))}",
                    lambda c=changed, w=wholes: outcome(c, folder, w),
                )
    return finish(args, outcomes.rows(), outcomes.missed(SLOW_S))
