"""A fault memory that is driven at random: what the kill tests kill.

Run as a program it starts one driving process after the other, each forked from it, so that none
waits for its imports: for every line ``FILE SEED`` on its input it prints ``pid N``, then what the
process announces, then ``end``. With ``make FILE`` it only makes a memory.
"""

import json
import os
import random
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from monitor.memory.codes import CODES, TESTS
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.store import Memory


def drive(store: DtcStore, seed: int) -> Iterator[str]:
    """Change the store for ever; yield what has happened after each change."""
    rng = random.Random(seed)
    faults, tests = sorted(CODES), sorted(TESTS)
    store.start_driving_cycle()
    yield "cycle"
    while True:
        t_ns = rng.randrange(10**12)
        dice = rng.random()
        if dice < 0.35:
            for dtc in store.fail(rng.choice(faults), t_ns):
                store.freeze(FreezeFrame(dtc.code, t_ns, {"engine_speed_rpm": t_ns / 7}))
            yield "fail"
        elif dice < 0.7:
            test = rng.choice(tests)
            store.count_judged(test)
            store.complete(test)
            yield "pass"
        elif dice < 0.77:
            store.clear()
            yield "clear"
        else:
            store.count_warm_up()
            store.count_general_denominator()
            store.counts.ignition_cycles += 1
            store.drive(600.0, 10.0)
            store.start_driving_cycle()
            yield "cycle"


def told(store: DtcStore) -> dict[str, Any]:
    """Return all of a store that diagnostics can ask for, as JSON has it."""
    counts = store.counts
    return {
        "status": {d.code: int(d.status) for d in store.all},
        "faults": {d.code: d.fault for d in store.all},
        "permanent": list(store.permanent),
        "frames": {c: [f.t_ns, dict(f.values)] for c, f in store.freeze_frames.items()},
        "ratios": {r.test: [r.numerator, r.denominator] for r in store.ratios},
        "ready": [test for test in sorted(TESTS) if store.completed_since_clear(test)],
        "counts": [counts.ignition_cycles, counts.warm_ups_since_clear],
        "driven": [counts.distance_since_clear_km, counts.engine_run_with_mil_s],
    }


def _drive_for_ever(path: Path, seed: int) -> None:
    """Store every change, then announce it, as the live loop does."""
    with closing(Memory(path, hold=True)) as memory:
        store = DtcStore(memory.load())
        for what in drive(store, seed):
            memory.save(store.saved)
            os.write(1, (json.dumps({"what": what} | told(store)) + "\n").encode())


def fork_for_every_line() -> None:
    """Fork a driving process for every line of the input."""
    for line in sys.stdin:
        path, seed = line.split()
        pid = os.fork()
        if pid == 0:
            try:
                _drive_for_ever(Path(path), int(seed))
            finally:
                os._exit(1)  # the input is the parent's
        os.write(1, f"pid {pid}\n".encode())
        os.waitpid(pid, 0)
        os.write(1, b"end\n")


if __name__ == "__main__":
    if sys.argv[1:]:
        Memory(Path(sys.argv[2])).close()
    else:
        fork_for_every_line()
