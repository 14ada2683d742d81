"""All chunks of a fleet, each stored as it is done; then the tables of all of them.

Workers return, this process writes. A chunk's files are renamed into place, the one that says what
it cost last: a run that was killed finds every finished chunk and judges only the others.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import polars as pl

from monitor.base.errors import UsageError
from training.fleet import drives as fleet_drives
from training.fleet.bench import Bench
from training.fleet.chunk_rows import Done, failed, joined
from training.fleet.drives import Chunk, Drive
from training.fleet.judging import judge_chunk
from training.jobs import parallel, run_folder, worker

Progress = Callable[[dict[str, Any]], None]  # takes what a chunk cost and found
TABLES: Final = ("recordings", "windows")
DIED: Final = "the process that judged this vehicle died: out of memory, or a crash in a library"


def work_folder(out: Path) -> Path:
    """Return the folder in which the finished chunks of a run lie until all are."""
    return out.with_name(f"{out.name}.work")


def written_paths(out: Path) -> tuple[Path, ...]:
    """Return what a run writes that might be taken for recordings."""
    return out, windows_path(out), work_folder(out), _old_folder(out)


def windows_path(out: Path) -> Path:
    """Return the table of windows that belongs to a table of recordings."""
    return out.with_name(f"{out.stem}.windows{out.suffix}")


def run(
    drives: Sequence[Drive],
    bench: Bench,
    out: Path,
    done: Progress,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """Judge all drives, write both tables and return what the run rests on and what it cost.

    Chunks that an earlier run of the same has finished are taken up.
    Raises UsageError if the work folder holds another run, or the scheduler cannot be used.
    """
    if out.suffix != ".parquet" or out.is_dir():
        raise UsageError(f"--out {out}: a table .parquet is wanted")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"--out {out}: the folder does not exist")
    folder = work_folder(out)
    identity = {**bench.identity(), "manifest_sha256": fleet_drives.digest(drives)}
    run_folder.claim(folder, identity)
    chunks = fleet_drives.chunks_of(drives)
    missing: dict[str, Chunk] = {}
    for chunk in chunks:
        found = _stored(folder, chunk.name)
        if found is None:
            missing[chunk.name] = chunk
        else:
            done(found)
    while missing:
        try:
            for name, result in parallel.run(
                judge_chunk, bench, list(missing.items()), jobs=jobs, scheduler=scheduler
            ):
                done(_store(folder, name, result))
                del missing[name]
        except worker.WorkerDiedError as died:
            for name in died.keys:
                result = _apart(missing.pop(name), bench, scheduler)
                done(_store(folder, name, result))
    for table, path in zip(TABLES, (out, windows_path(out)), strict=True):
        _join(folder, table, chunks, path)
    written = out.stat().st_size + windows_path(out).stat().st_size
    return {**identity, **_cost(folder, chunks), "written_bytes": written}


def finish(out: Path) -> None:
    """Remove the chunks of a run whose tables and report are written.

    Under another name first: a folder that is half removed must not be taken for a run.
    """
    old = _old_folder(out)
    shutil.rmtree(old, ignore_errors=True)
    work_folder(out).rename(old)
    shutil.rmtree(old)


def _old_folder(out: Path) -> Path:
    return out.with_name(f"{out.name}.old")


def _apart(chunk: Chunk, bench: Bench, scheduler: str | None) -> Done:
    """Return a chunk that may kill its worker; its halves are tried when it does.

    A vehicle whose worker dies although it is judged alone has failed.
    """
    try:  # with two jobs it is another process, which may die
        only = [(chunk.name, chunk)]
        run = parallel.run(judge_chunk, bench, only, jobs=2, scheduler=scheduler)
        return dict(run)[chunk.name]
    except worker.WorkerDiedError:
        n = len(chunk.vehicles)
        if n == 1:
            return failed(chunk.vehicles[0], DIED)
    halves = chunk.vehicles[: n // 2], chunk.vehicles[n // 2 :]
    return joined([_apart(Chunk(chunk.name, half), bench, scheduler) for half in halves])


def _stored(folder: Path, name: str) -> dict[str, Any] | None:
    try:
        found = json.loads((folder / f"{name}.json").read_text())
    except FileNotFoundError:
        return None
    return dict(found)


def _store(folder: Path, name: str, result: Done) -> dict[str, Any]:
    found = asdict(result)
    for table in TABLES:
        begun = folder / f"{name}.begun"
        begun.write_bytes(found.pop(table))
        begun.replace(folder / f"{name}.{table}.parquet")
    run_folder.write_json(folder / f"{name}.json", found)
    return found


def _join(folder: Path, table: str, chunks: Sequence[Chunk], path: Path) -> None:
    """Write one table of all chunks, some of them at a time."""
    begun = folder / f"{table}.begun"
    parts = [folder / f"{chunk.name}.{table}.parquet" for chunk in chunks]
    pl.scan_parquet(parts).sink_parquet(begun)
    begun.replace(path)


def _cost(folder: Path, chunks: Sequence[Chunk]) -> dict[str, Any]:
    found = [each for chunk in chunks if (each := _stored(folder, chunk.name)) is not None]
    steps = dict.fromkeys(key for each in found for key in each["seconds"])
    total: dict[str, Any] = {
        key: sum(each[key] for each in found)
        for key in ("drives", "errors", "faults", "driving_s", "size_bytes")
    }
    total["seconds"] = {step: sum(each["seconds"][step] for each in found) for step in steps}
    return total
