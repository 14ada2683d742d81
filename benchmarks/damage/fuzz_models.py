"""Load damaged and hostile model files: each is refused in one line, in time and memory bounds.

python -m benchmarks fuzz_models [--cases 10000]
"""

import random
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.damage.harness import Outcomes, fuzz_options
from benchmarks.measures import peak_mb
from benchmarks.outcome import finish, say
from monitor.pipeline.replay import shipped_model
from tests.helpers.model_damage import damaged, hostile, outcome

SLOW_S = 5.0
LARGE_MB = 500.0


def main(argv: Sequence[str]) -> int:
    """Count the outcomes; return 1 if one of them is an error."""
    args = fuzz_options(__name__, __doc__, 10_000, 100).parse_args(argv)
    draw, good = random.Random(args.seed), shipped_model().read_bytes()
    outcomes = Outcomes()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        files = [(f"damage {i}", damaged(good, draw)) for i in range(args.cases)]
        before_mb = peak_mb()
        for name, content in [*files, *hostile(good)]:
            found = outcomes.add(name, lambda c=content: outcome(c, good, path))
            if found != "refused" and not name.startswith("damage"):
                say(f"{name}: {found}")
        more_mb = peak_mb() - before_mb
    missed = outcomes.missed(SLOW_S) + [f"{LARGE_MB:g} MB"] * (more_mb > LARGE_MB)
    return finish(args, [*outcomes.rows(), {"more_memory_mb": more_mb}], missed)
