"""Kill processes on a fault memory with SIGKILL at random instants; nothing announced is lost.

Processes that drive a fault memory follow each other on one file; live loops run on a bus of
drives with codes. After each kill the file must be sound and hold what was announced last, or what
was to be announced next.

python -m benchmarks kills [--cases 500] [--loops 30]
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any, Final

from benchmarks.damage.harness import fuzz_options
from benchmarks.damage.killing.driven_memory import drive, told
from benchmarks.damage.killing.loop_on_memory import held, run
from benchmarks.outcome import Row, finish
from benchmarks.repository import ROOT
from monitor.memory.block import MISSING, Block
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.store import Memory

MOST_EVENTS: Final = 8  # before the kill
LONGEST_S: Final = 0.02  # between the last of these, or the process's beginning, and the kill


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
        told = loop_kills(Path(folder), loops, 2 if args.smallest else 3, rng)
        rows.append({"killed": f"live loop of up to {told} events", "n": loops})
    events = ("fail", "pass", "clear", "cycle")
    missed = [f"no kill after {what}" for what in events if not happened[what]]
    return finish(args, [*rows, {"seconds": time.monotonic() - begun_s}], missed)


def assert_sound(path: Path) -> None:
    """Fail if a file is damaged; the first storing may have ended before FILE.b."""
    first, partner = Block(path).parts
    assert first.content
    assert partner == MISSING or partner.content


def loaded(path: Path) -> Saved:
    """Return what the fault memory holds."""
    with closing(Memory(path)) as memory:
        return memory.load()


def killed(
    starter: "subprocess.Popen[str]", path: Path, seed: int, rng: random.Random
) -> list[str]:
    """Let a process drive the memory, kill it, return what it has announced."""
    assert starter.stdin is not None
    assert starter.stdout is not None
    starter.stdin.write(f"{path} {seed}\n")
    starter.stdin.flush()
    lines, n_events, pid = list[str](), rng.choice([0, rng.randrange(MOST_EVENTS)]), 0
    while not pid or len(lines) < n_events:
        line = starter.stdout.readline()
        if line.startswith("pid "):
            pid = int(line.split()[1])
        else:
            lines.append(line)
    time.sleep(rng.uniform(0.0, LONGEST_S))
    os.kill(pid, signal.SIGKILL)
    return [*lines, *iter(starter.stdout.readline, "end\n")]


def kills(path: Path, n: int, rng: random.Random) -> Counter[str]:
    """Kill ``n`` processes, one after the other, on one fault memory; return what happened.

    Fails if the file is damaged, or holds neither what was announced last nor what was to be
    announced next.
    """
    happened: Counter[str] = Counter()
    started = Saved()
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.damage.killing.driven_memory"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as starter:
        assert starter.stdin is not None
        for seed in range(n):
            # GIVEN a process that goes on from what the one before it has left
            lines = killed(starter, path, seed, rng)
            # WHEN it is killed while it stores and announces changes
            events = [json.loads(line) for line in lines]
            # THEN the file is sound
            if not path.exists():
                assert not events
                happened["not opened"] += 1
                continue
            assert_sound(path)
            found = json.loads(json.dumps(told(DtcStore(loaded(path)))))
            # and says what was announced last, or what was to be announced next, whole
            store = DtcStore(started)
            states = [json.loads(json.dumps(told(store)))]
            states += [
                {"what": what} | json.loads(json.dumps(told(store)))
                for what in islice(drive(store, seed), len(events) + 1)
            ]
            assert events == states[1:-1]
            possible = [{k: v for k, v in state.items() if k != "what"} for state in states[-2:]]
            assert found in possible
            happened.update(event["what"] for event in events)
            happened["kill between storing and announcing"] += found != possible[0]
            happened["nothing announced"] += not events
            started = loaded(path)
        starter.stdin.close()
    return happened


def loop_kills(folder: Path, n: int, drives: int, rng: random.Random) -> int:
    """Kill ``n`` live loops on a bus of drives, each on a fault memory of its own.

    Fails if a memory holds neither what its loop told last nor what was to be told next. Returns
    how many events a loop tells that nothing happens to.
    """
    whole = list[str]()
    run(folder / "whole.db", drives, whole.append)
    everything = list(map(json.loads, whole))
    expected = [{"told": held(Saved())}, *everything]
    for i in range(n):
        # WHEN it is killed at a random instant
        path = folder / f"{i}.db"
        kill_after, wait_s = rng.randrange(len(everything) - 5), rng.uniform(0.0, 0.05)
        events = told_by_loop(path, drives, kill_after, wait_s)
        # THEN it had told the same so far, and its memory holds that, or what was to come next
        assert events == everything[: len(events)]
        assert_sound(path)
        if events:
            found = json.loads(json.dumps({"told": held(loaded(path))}))
            assert found in expected[len(events) : len(events) + 2]
    return len(everything)


def told_by_loop(path: Path, drives: int, kill_after: int, wait_s: float) -> list[Any]:
    """Return what a loop of its own process tells until it is killed after so many events."""
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.damage.killing.loop_on_memory", path, str(drives)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    ) as loop:
        assert loop.stdout is not None
        told_events = (line for line in loop.stdout if line.startswith('{"told"'))
        lines = list(islice(told_events, kill_after))
        time.sleep(wait_s)
        loop.kill()
        return [json.loads(line) for line in [*lines, *told_events]]
