"""The run of a study: each chunk of its trials is a file, so that a killed run can resume."""

import argparse
import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from tqdm import tqdm

from benchmarks.studies import report
from benchmarks.studies.tables import Row
from monitor.base.config import Config
from training.jobs import parallel, run_folder

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Found = dict[str, Any]  # of a chunk: its rows under "rows", and what later chunks need of it
ROWS: Final = "rows"  # folder of the chunks


@dataclass(frozen=True, slots=True)
class Place:
    """Where a run keeps its chunks, and how many processes do them."""

    folder: Path
    jobs: int
    done: Callable[[int], object]  # called with the number of newly finished trials

    def lacks(self, names: Iterable[str]) -> bool:
        """Return whether a chunk is not done yet."""
        return not all((self.folder / ROWS / f"{name}.json").exists() for name in names)

    def do(
        self, function: Callable[[Shared, Item], Found], shared: Shared, items: Mapping[str, Item]
    ) -> dict[str, Found]:
        """Return what is found in each chunk; one that is in the folder is not done again.

        function : at the top level of its module; takes ``shared`` and an item
        """
        paths = {name: self.folder / ROWS / f"{name}.json" for name in items}
        found = {n: json.loads(p.read_text()) for n, p in paths.items() if p.exists()}
        self.done(sum(len(each["rows"]) for each in found.values()))
        missing = [(name, item) for name, item in items.items() if name not in found]
        for name, result in parallel.run(function, shared, missing, jobs=self.jobs):
            run_folder.write_json(paths[name], result)
            self.done(len(result["rows"]))
            found[name] = result
        return {name: found[name] for name in items}

    def rows(self) -> list[Row]:
        """Return the rows of all finished chunks, in the order of their names."""
        paths = sorted((self.folder / ROWS).glob("*.json"))
        return [row for path in paths for row in json.loads(path.read_text())["rows"]]


@contextmanager
def running(
    name: str,
    args: argparse.Namespace,
    plan: Any,
    total: int,
    made: Callable[[Sequence[Row]], report.Report],
    **digests: str,
) -> Iterator[Place]:
    """Give the place of a run; its report is written at the end, also of an interrupted run.

    total : number of trials
    made : makes the report of the rows
    digests : of files that the rows depend on
    Raises UsageError if the folder holds another run.
    """
    identity = {
        "plan": json.loads(json.dumps(dataclasses.asdict(plan))),
        **digests,
        "code_sha256": run_folder.code_sha256(Path(__file__).parent),
    }
    run_folder.claim(args.out, identity)
    (args.out / ROWS).mkdir(exist_ok=True)
    with tqdm(total=total, unit="trial", disable=None) as bar:
        place = Place(args.out, args.jobs, bar.update)
        try:
            yield place
        finally:
            bar.close()
            if rows := place.rows():
                report.write(made(rows), args.out, name)


def config_sha256(settings: Config) -> str:
    """Return the digest of a configuration."""
    return hashlib.sha256(json.dumps(dataclasses.asdict(settings)).encode()).hexdigest()
