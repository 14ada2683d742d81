"""Results of the study on disk: one JSON file each, written as soon as the result is there.

A study that was killed finds what is finished and runs only the rest.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from training.jobs import parallel
from training.jobs.run_folder import write_json

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = dict[str, Any]
PRIVATE = ("network", "weights", "one_step_weights")  # only in the result's file, not in study.json


def stored(path: Path) -> Result | None:
    """Return a stored result, None where there is none or only a part of one."""
    try:
        result = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return result if isinstance(result, dict) else None


def fan_out(
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Mapping[str, Item],
    folder: Path,
    label: str,
    **where: Any,
) -> dict[str, Result]:
    """Return the results by key, in the order of ``items``; finished ones are read from files.

    function : module-level function of ``shared`` and an item; returns JSON values
    items : the key names the file in ``folder``; long jobs should come first
    where : ``jobs`` and ``scheduler`` as of ``parallel.run``, and its errors
    """
    found = {k: result for k in items if (result := stored(folder / f"{k}.json")) is not None}
    missing = [(key, item) for key, item in items.items() if key not in found]
    done = parallel.run(function, shared, missing, **where)
    bar = tqdm(done, label, len(items), initial=len(found), unit="job", leave=False, disable=None)
    folder.mkdir(parents=True, exist_ok=True)
    for key, result in bar:
        write_json(folder / f"{key}.json", result)
        found[key] = result
    return {key: found[key] for key in items}


def public(result: Mapping[str, Any]) -> Result:
    """Return a result without what only its file holds."""
    return {k: v for k, v in result.items() if k not in PRIVATE}
