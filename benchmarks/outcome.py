"""What benchmarks share: options, and rows of figures as a table and as one JSON.

A row is a flat mapping of names to numbers and words. A benchmark that measured nothing ends with
an error: no row, or no number in any of them.
"""

import argparse
import json
import math
import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from benchmarks.repository import commit

SCHEMA = "o2bench/1"
ABOUT = ("json", "benchmark", "commit")  # no options that change a figure
Row = Mapping[str, str | float | bool | None]


class BenchmarkOptions(argparse.ArgumentParser):
    """The options of a benchmark: its own, ``--json FILE`` and ``--smallest``.

    module, doc : name and docstring of its module
    smallest : what ``--smallest`` sets, as defaults of the other options
    """

    def __init__(self, module: str, doc: str | None, **smallest: Any) -> None:
        super().__init__(
            prog=f"python -m benchmarks {module.rpartition('.')[2]}",
            description=doc,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self._smallest = smallest
        self.add_argument("--json", type=Path, metavar="FILE", help="write rows and commit")
        self.add_argument("--smallest", action="store_true", help=f"as a check: {smallest}")

    def parse_args(self, argv: Sequence[str]) -> argparse.Namespace:  # type: ignore[override]
        """Return the options; what was given explicitly stands before what is smallest."""
        args = super().parse_args(argv)
        if args.smallest:
            self.set_defaults(**self._smallest)
            args = super().parse_args(argv)
        args.benchmark, args.commit = self.prog.rpartition(" ")[2], commit()
        return args


def say(line: str) -> None:
    """Print progress, which is no result."""
    print(line, file=sys.stderr, flush=True)


def finish(args: argparse.Namespace, rows: Sequence[Row], missed: Iterable[str] = ()) -> int:
    """Print the rows, write the JSON; return 1 if something was missed, otherwise 0.

    missed : targets or promises, one line each
    Raises SystemExit if nothing was measured.
    """
    if not any(_is_number(value) for row in rows for value in row.values()):
        raise SystemExit(f"{args.benchmark}: nothing was measured")
    failures = list(missed)
    print("\n".join(table(rows)), flush=True)
    for line in failures:
        print(f"missed: {line}", flush=True)
    if args.json:
        about = {
            "schema": SCHEMA,
            "benchmark": args.benchmark,
            "commit": args.commit,
            "machine": f"{platform.machine()}, {os.cpu_count()} cores",
            "python": platform.python_version(),
            "options": {k: v for k, v in vars(args).items() if k not in ABOUT},
            "rows": [{name: _finite(value) for name, value in row.items()} for row in rows],
            "missed": failures,
        }
        args.json.write_text(json.dumps(about, indent=1, default=str) + "\n")
    return 1 if failures else 0


def table(rows: Sequence[Row]) -> Iterable[str]:
    """Yield the lines of a table, a new one wherever the rows have other columns."""
    for columns, group in groupby(rows, key=tuple):
        cells = [list(columns), *([_cell(value) for value in row.values()] for row in group)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for line in cells:
            padded = (
                f"{cell:>{width}}" if cell[:1].isdigit() else f"{cell:<{width}}"
                for cell, width in zip(line, widths, strict=True)
            )
            yield "  ".join(padded).rstrip()


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _finite(value: str | float | bool | None) -> str | float | bool | None:
    """Return the value, None for a number that JSON has not."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cell(value: str | float | bool | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.0f}" if 1e4 <= abs(value) < 1e15 else f"{value:.4g}"
    return str(value)
