"""What every fuzzer has: its options, and counts of what became of the damaged things."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.outcome import Options, Row, say


def fuzz_options(module: str, doc: str | None, cases: int, smallest: int) -> Options:
    """Return the options ``--cases``, ``--seed`` and ``--keep``, the folder of failures."""
    options = Options(module, doc, cases=smallest)
    options.add_argument("--cases", type=int, default=cases, help=f"how many (default: {cases})")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--keep", type=Path, default=Path("build/fuzz"), help="of failures")
    return options


@dataclass(slots=True)
class Outcomes:
    """How often each outcome came; one in capitals is an error."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    slowest: str = ""

    def add(self, name: str, work: Callable[[], str]) -> str:
        """Do the work on one damaged thing and count its outcome."""
        began_s = time.monotonic()
        found = work()
        took_s = time.monotonic() - began_s
        if took_s > self.slowest_s:
            self.slowest_s, self.slowest = took_s, name
        self.counts[found] += 1
        if is_error(found):
            say(f"{name}: {found}")
        return found

    def rows(self) -> list[Row]:
        """Return a row for each outcome, and one of the slowest."""
        found: list[Row] = [{"outcome": o, "cases": n} for o, n in self.counts.most_common()]
        return [*found, {"slowest": self.slowest, "seconds": self.slowest_s}]

    def missed(self, slow_s: float) -> list[str]:
        """Return errors, and whether one case was slower than allowed."""
        errors = [f"{o}: {n} cases" for o, n in self.counts.items() if is_error(o)]
        return errors + [f"{slow_s:g} s for {self.slowest}"] * (self.slowest_s > slow_s)


def is_error(outcome: str) -> bool:
    """Return whether an outcome is one that must not happen."""
    return outcome.split(maxsplit=1)[0].isupper()
