"""What fuzzers share: options, counts of outcomes, and calls in a process of their own.

A child for calls is forked from a process that has imported everything already, and makes many, so
a call costs little more than its work. A call that kills the child or takes too long ends the
child; the next one goes on with the calls that are left.
"""

import gc
import io
import json
import os
import resource
import select
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from benchmarks.measures import peak_mb
from benchmarks.outcome import BenchmarkOptions, Row, say

HANG_S: Final = 5.0  # the lesser of wall and processor time, because other work runs beside it
MOST_MB: Final = 1000.0
KILL_S: Final = 60.0
ALLOWED: Final = (0, 1, 2, 3)

Job = Callable[[], int]


def fuzz_options(module: str, doc: str | None, cases: int, smallest: int) -> BenchmarkOptions:
    """Return the options ``--cases``, ``--seed`` and ``--keep``, the folder of failures."""
    options = BenchmarkOptions(module, doc, cases=smallest)
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


@dataclass(frozen=True, slots=True)
class CallOutcome:
    """What became of a call."""

    code: int  # negative: the signal that ended it
    last_line: str  # of stderr
    n_lines: int  # of stderr
    wall_s: float
    cpu_s: float
    peak_mb: float  # of resident memory, with what the parent had

    def complaints(self, most_mb: float) -> list[str]:
        """Return which promises a command broke."""
        found = []
        if self.code not in ALLOWED:
            found.append("crash" if self.code < 0 else f"exit {self.code}")
        if min(self.wall_s, self.cpu_s) > HANG_S:
            found.append("hang")
        if self.peak_mb > most_mb:
            found.append("memory")
        if self.code == 2 and not self.last_line.startswith(("o2mon: ", "o2train: ")):
            found.append("no last line")
        return found


@dataclass(slots=True)
class Tally:
    """Counts over many calls."""

    most_mb: float = MOST_MB
    calls: int = 0
    codes: Counter[int] = field(default_factory=Counter)
    complaints: Counter[str] = field(default_factory=Counter)
    longest_s: float = 0.0
    peak_mb: float = 0.0

    def add(self, outcome: CallOutcome) -> list[str]:
        """Count a call; return which promises it broke."""
        self.calls += 1
        self.codes[outcome.code] += 1
        self.longest_s = max(self.longest_s, min(outcome.wall_s, outcome.cpu_s))
        self.peak_mb = max(self.peak_mb, outcome.peak_mb)
        broken = outcome.complaints(self.most_mb)
        self.complaints.update(broken)
        return broken

    def merge(self, other: "Tally") -> None:
        """Count all that another one has counted."""
        self.calls += other.calls
        self.codes += other.codes
        self.complaints += other.complaints
        self.longest_s = max(self.longest_s, other.longest_s)
        self.peak_mb = max(self.peak_mb, other.peak_mb)

    def row(self, of: str) -> Row:
        """Return the counts as a row."""
        codes = ", ".join(f"{code}: {n}" for code, n in sorted(self.codes.items()))
        return {
            "of": of,
            "calls": self.calls,
            "exit codes": codes,
            "broken promises": self.complaints.total(),
            "longest_s": self.longest_s,
            "peak_mb": self.peak_mb,
        }

    def missed(self) -> list[str]:
        """Return the broken promises and how often each was."""
        return [f"{what}: {n} calls" for what, n in self.complaints.items()]


def call(job: Job, kill_s: float = KILL_S) -> CallOutcome:
    """Run one job in a child; its result is the exit code."""
    (outcome,) = calls([job], kill_s)
    return outcome


def calls(jobs: Sequence[Job], kill_s: float = KILL_S) -> Iterator[CallOutcome]:
    """Run jobs one after the other in a child, and in another one after each that ends it."""
    done = 0
    while done < len(jobs):
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reader)
            _work(jobs[done:], writer)
        os.close(writer)
        with os.fdopen(reader, "rb", buffering=0) as records:
            while done < len(jobs):
                begun_s = time.monotonic()
                record = _line(records, kill_s)
                if record is None:
                    os.kill(child, signal.SIGKILL)
                    break
                done += 1
                yield CallOutcome(**json.loads(record))
        _, status, usage = os.wait4(child, 0)
        if done < len(jobs):
            done += 1
            took_s, code = time.monotonic() - begun_s, os.waitstatus_to_exitcode(status)
            yield CallOutcome(code, "", 0, took_s, took_s, usage.ru_maxrss / 1024)


def _line(records: io.RawIOBase, within_s: float) -> bytes | None:
    """Return the next record, None if the child has ended or its time is over."""
    until_s, line = time.monotonic() + within_s, b""
    while not line.endswith(b"\n"):
        left_s = until_s - time.monotonic()
        if left_s <= 0 or not select.select([records], [], [], left_s)[0]:
            return None
        part = records.read(1)
        if not part:
            return None
        line += part
    return line


def _work(jobs: Sequence[Job], writer: int) -> None:
    try:
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        gc.freeze()
        for job in jobs:
            os.write(writer, (json.dumps(_outcome(job)) + "\n").encode())
    finally:
        os._exit(0)


def _outcome(job: Job) -> dict[str, float | str]:
    """Return the fields of an outcome; runs in the child."""
    sys.stdout, sys.stderr = io.StringIO(), io.StringIO()
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    begun_s, cpu_s = time.monotonic(), time.process_time()
    try:
        code = job()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        code = 70
    lines = sys.stderr.getvalue().strip().splitlines()
    return {
        "code": code,
        "last_line": lines[-1] if lines else "",
        "n_lines": len(lines),
        "wall_s": time.monotonic() - begun_s,
        "cpu_s": time.process_time() - cpu_s,
        "peak_mb": peak_mb(),
    }
