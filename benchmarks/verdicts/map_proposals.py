"""Precision and recall of ``o2mon map`` on databases with labels made by hand.

FOLDER holds the databases, in any folders below; a label names a file without its suffix. The
shipped labels are for opendbc 0.3.1 (``pip download opendbc``, unpacked). A line of the map counts
if it stands uncommented. Precision: right lines of all that stand. Recall: quantities with a right
line of all that a database names with their unit.

python -m benchmarks map_proposals FOLDER [--set 4]
"""

import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from monitor.decode.bus_map import read_database
from monitor.mapping.map_proposal import make_map

PRECISION, RECALL = 0.99, 0.8
LABELS = Path(__file__).with_name("map_labels.toml")


def score(path: Path, label: dict[str, Any]) -> Row:
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
    return {
        "database": path.stem,
        "lines": len(stands),
        "wrong": len(wrong),
        "expected": len(expected),
        "missed": len(missed),
        "which": "; ".join((*wrong, *missed)),
    }


def main(argv: Sequence[str]) -> int:
    """Score all databases; return 1 if a target is missed."""
    options = BenchmarkOptions(__name__, __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--labels", type=Path, default=LABELS)
    options.add_argument("--set", type=int, default=4, help="set of labels (default: 4)")
    args = options.parse_args(argv)
    labels = tomllib.loads(args.labels.read_text())
    paths, rows = {path.stem: path for path in args.folder.rglob("*.dbc")}, list[Row]()
    warnings.simplefilter("ignore")
    for name, label in labels.items():
        if label.get("set", 1) == args.set and name in paths:
            rows.append(score(paths[name], label))
        elif label.get("set", 1) == args.set:
            say(f"{name}: not in {args.folder}")
    if not rows:
        return finish(args, rows)
    lines, wrong, expected, missed = (
        sum(int(row[key] or 0) for row in rows) for key in ("lines", "wrong", "expected", "missed")
    )
    precision, recall = (lines - wrong) / max(lines, 1), (expected - missed) / max(expected, 1)
    whole: Row = {"databases": len(rows), "precision %": 100 * precision, "recall %": 100 * recall}
    below = [f"precision {PRECISION:.0%}"] * (precision < PRECISION)
    return finish(args, [*rows, whole], below + [f"recall {RECALL:.0%}"] * (recall < RECALL))
