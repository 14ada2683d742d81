"""Jobs of the study side by side on this machine's cores or on a Dask cluster, each stored at once.

A job is a function of shared data and its own settings. What it returns is written to two files
named by its key, both renamed into place, the JSON last: a study that was killed finds every
finished job and runs only the others.
"""

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

import joblib
import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from monitor.errors import UsageError
from monitor.types import FloatArray

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Arrays = dict[str, FloatArray]
Done = tuple[dict[str, Any], Arrays]
CONNECT_S = 10.0  # wait for a scheduler's answer
WATCH_S = 1.0  # how often a worker looks whether its study still lives


def run(
    function: Callable[[Shared, Item], Done],
    shared: Shared,
    items: Mapping[str, Item],
    directory: Path,
    *,
    jobs: int = 2,
    scheduler: str | None = None,
    label: str = "",
) -> dict[str, dict[str, Any]]:
    """Return the results by key, in the order of ``items``; those already stored are read.

    function : module-level, takes ``shared`` and an item; returns a JSON-able dict and arrays
    items : by key, which names the files in ``directory``; long jobs should come first
    scheduler : address of a Dask scheduler, ``tcp://host:port``; None uses ``jobs`` processes here
    Raises UsageError if the scheduler cannot be used.
    """
    directory.mkdir(parents=True, exist_ok=True)
    found = {key: result for key in items if (result := stored(directory, key)) is not None}
    missing = {key: item for key, item in items.items() if key not in found}
    bar = tqdm(
        total=len(items), initial=len(found), desc=label, unit="job", leave=False, disable=None
    )
    with bar, _backend(scheduler, jobs, shared):
        # Workers return, this process writes: a cluster needs no common file system.
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, max_nbytes=None, pre_dispatch="2*n_jobs"
        )
        calls = (joblib.delayed(_call)(function, shared, k, item) for k, item in missing.items())
        for key, (result, arrays) in parallel(calls) if missing else ():
            _store(directory, key, result, arrays)
            found[key] = result
            bar.update()
    return {key: found[key] for key in items}


def stored(directory: Path, key: str) -> dict[str, Any] | None:
    """Return the result of a finished job, or None."""
    try:
        result = json.loads((directory / f"{key}.json").read_text())
    except (OSError, ValueError):
        return None
    return result if isinstance(result, dict) and (directory / f"{key}.npz").exists() else None


def arrays_of(directory: Path, key: str) -> Arrays:
    """Return the arrays of a finished job."""
    with np.load(directory / f"{key}.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _call(
    function: Callable[[Shared, Item], Done], shared: Shared, key: str, item: Item
) -> tuple[str, Done]:
    with threadpool_limits(1):  # one thread is the fastest on small matrices
        return key, function(shared, item)


def _store(directory: Path, key: str, result: dict[str, Any], arrays: Arrays) -> None:
    temporary = directory / f".{key}.part"
    with temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    temporary.replace(directory / f"{key}.npz")
    temporary.write_text(json.dumps(result, allow_nan=False))
    temporary.replace(directory / f"{key}.json")


@contextmanager
def _backend(scheduler: str | None, jobs: int, shared: object) -> Iterator[None]:
    if scheduler is None:
        watch = {"initializer": _end_with, "initargs": (os.getpid(),)} if jobs != 1 else {}
        with joblib.parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1, **watch):
            yield
        return
    with _client(scheduler), joblib.parallel_config("dask", n_jobs=-1, scatter=[shared]):
        yield


def _end_with(parent: int) -> None:
    """End this worker when the study is killed; it would wait for jobs for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


@contextmanager
def _client(scheduler: str) -> Iterator[None]:
    try:
        from distributed import Client  # noqa: PLC0415 - an extra that few need
    except ImportError as error:
        raise UsageError(
            f"scheduler {scheduler}: needs dask; pip install 'o2-monitor[fleet]'"
        ) from error
    try:
        client = Client(scheduler, timeout=CONNECT_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise UsageError(f"scheduler {scheduler}: no answer; wanted tcp://host:port") from error
    with client:
        yield
