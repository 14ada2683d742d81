"""Run a fleet: judge its chunks, store every finished chunk, and join the chunks to tables.

Workers return results; this process writes them. It renames the files of a chunk into place, the
file with the cost last. So a run that continues after a kill finds every finished chunk and judges
only the missing chunks.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

from monitor.base.errors import UsageError
from monitor.base.files.outputs import replaced
from training.fleet import drives as fleet_drives
from training.fleet.chunk_rows import Done, failed, joined
from training.fleet.drives import Chunk, FleetDrive
from training.fleet.judging import judge_chunk
from training.fleet.worker_kit import WorkerKit
from training.jobs import parallel, run_folder, worker
from training.recordings.files.table_files import GENERATOR

Progress = Callable[[dict[str, Any]], None]  # takes the counts and the cost of a finished chunk
TABLES: Final = ("recordings", "windows")
DIED: Final = "the process that judged this vehicle died: out of memory, or a crash in a library"


def work_folder(out: Path) -> Path:
    """Return the folder that holds the finished chunks until the run ends."""
    return out.with_name(f"{out.name}.work")


def windows_path(out: Path) -> Path:
    """Return the path of the table of windows beside the table of recordings ``out``."""
    return out.with_name(f"{out.stem}.windows{out.suffix}")


def run(
    drives: Sequence[FleetDrive],
    kit: WorkerKit,
    out: Path,
    done: Progress,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """Judge all drives, write both tables, and return the identity and the cost of the run.

    The run uses the finished chunks of an earlier, killed run with the same drives and kit.

    out : table of recordings to write, .parquet
    done : takes the counts and the cost of every finished chunk, also of earlier ones
    jobs : number of processes on this machine
    scheduler : URL of a Dask scheduler; None uses this machine
    Raises UsageError if ``out`` is impossible, the work folder holds another run, or the scheduler
    cannot be used.
    """
    if out.suffix != ".parquet" or out.is_dir():
        raise UsageError(f"--out {out}: a table .parquet is wanted")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"--out {out}: the folder does not exist")
    folder = work_folder(out)
    identity = {**kit.identity(), "manifest_sha256": fleet_drives.digest(drives)}
    run_folder.claim(folder, identity)
    chunks = fleet_drives.chunks_of(drives)
    stored = {chunk.name: _stored(folder, chunk.name) for chunk in chunks}
    for cost in filter(None, stored.values()):
        done(cost)
    missing = {chunk.name: chunk for chunk in chunks if not stored[chunk.name]}
    while missing:
        try:
            for name, result in parallel.run(
                judge_chunk, kit, list(missing.items()), jobs=jobs, scheduler=scheduler
            ):
                done(_store(folder, name, result))
                del missing[name]
        except worker.WorkerDiedError as died:
            for name in died.keys:
                done(_store(folder, name, _apart(missing.pop(name), kit, scheduler)))
    for table, path in zip(TABLES, (out, windows_path(out)), strict=True):
        parts = [folder / f"{chunk.name}.{table}.parquet" for chunk in chunks]
        with replaced(path) as begun:  # only a part of the chunks is in memory at a time
            pl.scan_parquet(parts, glob=False).sink_parquet(begun, metadata=GENERATOR)
    written = out.stat().st_size + windows_path(out).stat().st_size
    return {**identity, **_cost(folder, chunks), "written_bytes": written}


def finish(out: Path) -> None:
    """Remove the chunks of a run after its tables and report are written; other files stay.

    The file that says a chunk is finished goes first, as it came last.
    """
    folder = work_folder(out)
    for pattern in ("chunk_*.json", "chunk_*.parquet", run_folder.RUN):
        for path in folder.glob(pattern):
            path.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()


def _apart(chunk: Chunk, kit: WorkerKit, scheduler: str | None) -> Done:
    """Return the result of a chunk that may kill its worker.

    If the worker dies, the function tries both halves of the chunk. If the worker dies with a
    single vehicle, the drives of this vehicle have failed.
    """
    try:  # two jobs use another process, which may die
        only = [(chunk.name, chunk)]
        run = parallel.run(judge_chunk, kit, only, jobs=2, scheduler=scheduler)
        return dict(run)[chunk.name]
    except worker.WorkerDiedError:
        n = len(chunk.vehicles)
        if n == 1:
            return failed(chunk.vehicles[0], DIED)
    halves = chunk.vehicles[: n // 2], chunk.vehicles[n // 2 :]
    return joined([_apart(Chunk(chunk.name, half), kit, scheduler) for half in halves])


def _stored(folder: Path, name: str) -> dict[str, Any] | None:
    try:
        stored = json.loads((folder / f"{name}.json").read_text())
    except FileNotFoundError:
        return None
    return dict(stored)


def _store(folder: Path, name: str, result: Done) -> dict[str, Any]:
    for table in TABLES:
        with replaced(folder / f"{name}.{table}.parquet") as begun:
            getattr(result, table).write_parquet(begun)
    run_folder.write_json(folder / f"{name}.json", result.cost)
    return result.cost


def _cost(folder: Path, chunks: Sequence[Chunk]) -> dict[str, Any]:
    costs = [cost for chunk in chunks if (cost := _stored(folder, chunk.name)) is not None]
    steps = dict.fromkeys(step for cost in costs for step in cost["seconds"])
    total: dict[str, Any] = {
        key: sum(cost[key] for cost in costs)
        for key in ("drives", "errors", "faults", "driving_s", "size_bytes")
    }
    total["seconds"] = {step: sum(c["seconds"].get(step, 0.0) for c in costs) for step in steps}
    return total
