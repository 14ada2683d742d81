"""Parallel jobs of the study, stored as soon as they finish.

A job is a function of shared data and an item with its settings. Its result goes to two files named
by the job's key, a JSON and an NPZ file. Both are renamed into place, the JSON file last. A study
that was killed finds all finished jobs and runs only the rest.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from monitor.base.files.outputs import replaced, write_text
from monitor.base.types import FloatArray
from training.jobs import parallel

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Arrays = dict[str, FloatArray]
Done = tuple[dict[str, Any], Arrays]


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
    """Return the results by key, in the order of ``items``; stored results are read from files.

    function : module-level function of ``shared`` and an item; returns a dict of JSON values and
        arrays
    items : key → item; the key names the files in ``directory``; long jobs should come first
    scheduler : address of a Dask scheduler, ``tcp://host:port``; None uses ``jobs`` processes on
        this machine
    label : text of the progress bar
    Raises UsageError if the scheduler cannot be used.
    """
    directory.mkdir(parents=True, exist_ok=True)
    found = {key: result for key in items if (result := stored(directory, key)) is not None}
    missing = {key: item for key, item in items.items() if key not in found}
    bar = tqdm(
        total=len(items), initial=len(found), desc=label, unit="job", leave=False, disable=None
    )
    with bar:
        done = parallel.run(function, shared, missing.items(), jobs=jobs, scheduler=scheduler)
        for key, (result, arrays) in done:
            _store(directory, key, result, arrays)
            found[key] = result
            bar.update()
    return {key: found[key] for key in items}


def stored(directory: Path, key: str) -> dict[str, Any] | None:
    """Return the result of a finished job, None for any other job."""
    try:
        result = json.loads((directory / f"{key}.json").read_text())
    except (OSError, ValueError):
        return None
    return result if isinstance(result, dict) and (directory / f"{key}.npz").exists() else None


def arrays_of(directory: Path, key: str) -> Arrays:
    """Return the arrays of a finished job."""
    with np.load(directory / f"{key}.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _store(directory: Path, key: str, result: dict[str, Any], arrays: Arrays) -> None:
    with replaced(directory / f"{key}.npz") as begun:
        np.savez(begun, allow_pickle=False, **arrays)
    write_text(directory / f"{key}.json", json.dumps(result, allow_nan=False))
