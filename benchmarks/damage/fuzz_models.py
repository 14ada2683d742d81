"""Load damaged and hostile model files: each is refused in one line, in time and memory bounds.

Run with: python -m benchmarks fuzz_models [--damages 10000] [--seed 1]
"""

import random
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.fuzz_options import fuzz_parser
from monitor.pipeline.replay import shipped_model
from tests.helpers.model_damage import damaged, hostile, outcome

SLOW_S = 5.0
LARGE_MB = 500.0


def main(argv: Sequence[str]) -> int:
    """Print how often each outcome came; return 1 if one of them is an error."""
    parser = fuzz_parser(__doc__, "damages", 10_000)
    args = parser.parse_args(argv)
    draw, good = random.Random(args.seed), shipped_model().read_bytes()
    counts, slowest_s, slowest = Counter[str](), 0.0, ""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        files = [(f"damage {i}", damaged(good, draw)) for i in range(args.damages)]
        files += list(hostile(good))
        before_mb = peak_mb()
        for name, content in files:
            began_s = time.monotonic()
            found = outcome(content, good, path)
            took_s = time.monotonic() - began_s
            if took_s > slowest_s:
                slowest_s, slowest = took_s, name
            counts[found] += 1
            if found.split()[0].isupper() or (not name.startswith("damage") and found != "refused"):
                print(f"{name}: {found}")
    for found, n in counts.most_common():
        print(f"{n:6}  {found}")
    print(f"slowest {slowest_s:.2f} s ({slowest}); {peak_mb() - before_mb:.0f} MB more memory")
    bad = sum(n for found, n in counts.items() if found.split()[0].isupper())
    return int(bad > 0 or slowest_s > SLOW_S or peak_mb() - before_mb > LARGE_MB)


def peak_mb() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
