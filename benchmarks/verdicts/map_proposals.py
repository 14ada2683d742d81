"""Precision and recall of ``o2mon map`` on databases with labels made by hand.

    python -m benchmarks map_proposals FOLDER [--labels benchmarks/map_labels.toml]

FOLDER holds the databases, in any folders below; a label names a file without its suffix. The
shipped labels are for opendbc 0.3.1 (``pip download opendbc``, unpacked). A line of the map counts
if it stands uncommented. Precision: right lines of all that stand. Recall: quantities with a right
line of all that a database names with their unit.
"""

import argparse
import sys
import tomllib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monitor.decode.bus_map import read_database
from monitor.mapping.text import make_map

LABELS = Path(__file__).with_name("map_labels.toml")


@dataclass(frozen=True, slots=True)
class Score:
    """One database: lines that stand, right ones, and quantities found of those expected."""

    name: str
    lines: int
    wrong: tuple[str, ...]
    expected: int
    missed: tuple[str, ...]


def score(path: Path, label: dict[str, Any]) -> Score:
    """Return how the proposals for a database agree with its label."""
    database, notes = read_database(path)
    _, proposals = make_map(database, path, notes=notes)
    stands = {c.name: c.place for c in proposals.found}
    possible = label.get("possible", {})
    expected = {name: places for name, places in label.items() if isinstance(places, list)}
    wrong = tuple(
        f"{name} = {place}"
        for name, place in stands.items()
        if place not in (*expected.get(name, ()), *possible.get(name, ()))
    )
    missed = tuple(n for n, places in expected.items() if stands.get(n) not in places)
    return Score(path.stem, len(stands), wrong, len(expected), missed)


def main(argv: Sequence[str]) -> int:
    """Print a table of all databases with precision and recall; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--labels", type=Path, default=LABELS)
    parser.add_argument("--set", type=int, default=4, help="set of labels (default: 4)")
    args = parser.parse_args(argv)
    labels = tomllib.loads(args.labels.read_text())
    paths = {path.stem: path for path in args.folder.rglob("*.dbc")}
    warnings.simplefilter("ignore")
    scores = []
    for name, label in labels.items():
        if label.get("set", 1) != args.set:
            continue
        if name not in paths:
            print(f"{name}: not in {args.folder}", file=sys.stderr)
            continue
        scores.append(score(paths[name], label))
        each = scores[-1]
        print(f"{name:<28} {each.lines:2d} lines, {each.expected:2d} expected", end="")
        print("".join(f"; WRONG {line}" for line in each.wrong), end="")
        print(f"; missed {', '.join(each.missed)}" if each.missed else "")
    lines, wrong = sum(s.lines for s in scores), sum(len(s.wrong) for s in scores)
    expected, missed = sum(s.expected for s in scores), sum(len(s.missed) for s in scores)
    precision = (lines - wrong) / max(lines, 1)
    recall = (expected - missed) / max(expected, 1)
    print(f"{len(scores)} databases")
    print(f"precision {100 * precision:.1f} % ({lines - wrong} of {lines} lines; wanted 99 %)")
    print(f"recall {100 * recall:.1f} % ({expected - missed} of {expected}; wanted 80 %)")
    return 0 if precision >= 0.99 and recall >= 0.8 else 1
