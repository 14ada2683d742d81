"""Damage the files of a fault memory in random ways and start on them: nothing silent or fatal.

python -m benchmarks fuzz_memory [--cases 10000]
"""

import random
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from benchmarks.damage.harness import Outcomes, fuzz_options
from benchmarks.outcome import finish
from monitor.base.config import shipped
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.obd_records import FreezeFrame, TestResult
from monitor.memory.reference import Reference, Seen
from monitor.memory.store import Memory

MODEL = "a" * 64
FAULTS = ("slow_symmetric", "biased_lean", "signal_missing", "delay_rich_to_lean", "gain_low")


def full_store() -> DtcStore:
    """Return a store with codes in every state, frames, results and counts."""
    store = DtcStore()
    for cycle in range(4):
        store.start_driving_cycle()
        for fault in FAULTS[: 5 - cycle]:
            for dtc in store.fail(fault, 10**18 + cycle):
                store.freeze(FreezeFrame(dtc.code, 10**18 + cycle, {"engine_speed_rpm": 2000.5}))
        store.counts.ignition_cycles += 1
        store.count_general_denominator()
        store.drive(60.25, 1.5)
    store.report([TestResult("response", f"lag_{i}_s", 0.1 * i, -1.0, 1.0) for i in range(6)])
    return store


def stored(path: Path, saves: int = 3) -> None:
    """Make a memory that was stored several times, with a reference of the vehicle."""
    saved = full_store().saved
    with closing(Memory(path, hold=True)) as memory:
        for n in range(saves):
            counts = replace(saved.counts, ignition_cycles=100 + n)
            memory.save(replace(saved, counts=counts))
        memory.learn(MODEL, Seen(0.01, 1.02), shipped().bias)


def memories(folder: Path) -> dict[str, dict[str, bytes]]:
    """Return the files of a memory that was closed, and after a kill between its two writings."""
    path = folder / "o2.db"
    stored(path)
    closed = files_of(path)
    with closing(Memory(path, hold=True)) as memory:
        memory.save(Saved(dtcs=full_store().saved.dtcs))
    return {"closed": closed, "killed": closed | {path.name: path.read_bytes()}}


def content(path: Path) -> tuple[str, Path | None, Saved, Reference]:
    """Return what a start finds: the condition, the file put aside, codes and reference."""
    with closing(Memory(path, hold=True)) as memory:
        state, _, aside = memory.condition
        return state, aside, memory.load(), memory.reference(MODEL)


def damaged(data: bytes, draw: random.Random) -> bytes:
    """Return a file's content with flipped bits, cut off, overwritten or with a lost sector."""
    kind, changed = draw.randrange(6), bytearray(data)
    at = draw.randrange(len(data)) if data else 0
    if not data or kind == 0:
        return data[:at]
    if kind == 5 and draw.random() < 0.2:
        return draw.choice([b"\0", b"\xff", b"no memory at all "]) * len(data)
    if kind == 1:
        sector = at // 512 * 512
        changed[sector : sector + 512] = draw.choice([b"\0", b"\xff"]) * len(
            changed[sector : sector + 512]
        )
    elif kind == 2:
        changed[at : at + 40] = draw.randbytes(len(changed[at : at + 40]))
    else:
        for _ in range(draw.choice([1, 1, 1, 3, 30])):
            changed[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def attacks(
    files: dict[str, bytes], draw: random.Random, n: int
) -> Iterator[tuple[dict[str, bytes], set[str]]]:
    """Yield the files of a memory with damage in one or several of them, and which have it."""
    for _ in range(n):
        victims = {draw.choice(list(files))}
        if draw.random() < 0.3:
            victims |= {name for name in files if draw.random() < 0.7}
        yield (
            {
                name: damaged(data, draw) if name in victims else data
                for name, data in files.items()
            },
            victims,
        )


def put(files: dict[str, bytes], folder: Path) -> None:
    """Make a folder that holds these files and no others."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)


def files_of(path: Path) -> dict[str, bytes]:
    """Return the files of a memory by name."""
    return {file.name: file.read_bytes() for file in (path, path.with_name(f"{path.name}.b"))}


def outcome(files: dict[str, bytes], folder: Path, wholes: list[tuple[Saved, Reference]]) -> str:
    """Return what became of a damaged memory: ok, repaired, lost, or in capitals an error.

    wholes : contents that the files may hold; a kill leaves one more than it should
    """
    put(files, folder)
    path = folder / "o2.db"
    try:
        state, aside, *found = content(path)
    except Exception as error:
        return f"FATAL {type(error).__name__}: {error}"
    if state == "lost":
        if found != [Saved(), Reference()]:
            return "LOST BUT NOT EMPTY"
        if aside is None or not aside.exists():
            return "NOT PUT ASIDE"
        return state if content(path)[0] == "lost" else "LOSS FORGOTTEN"
    if tuple(found) not in wholes:
        return f"SILENT ({state})"
    return state if content(path)[0] == "ok" else f"STILL DAMAGED ({state})"


def contents(files: dict[str, bytes], folder: Path) -> list[tuple[Saved, Reference]]:
    """Return what each file of a memory holds."""
    wholes = []
    for name, data in files.items():
        put({name: data}, folder)
        wholes.append(content(folder / "o2.db")[2:])
    return wholes


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
