"""The result of a study as JSON and as the lines that the command prints."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any, Final

import monitor
from benchmarks.studies.workflow import tables
from benchmarks.studies.workflow.answers import CLASSES
from benchmarks.studies.workflow.case import Row
from benchmarks.studies.workflow.plan import Study
from benchmarks.studies.workflow.targets import Target, assess

SCHEMA: Final = "o2train.gap-study/1"
PACKAGES: Final = ("numpy", "scipy", "numba")
ERRORS_SHOWN: Final = 20


def result(rows: Sequence[Row], study: Study, identity: dict[str, Any]) -> dict[str, Any]:
    """Return the whole result of a study."""
    return {
        "schema": SCHEMA,
        "source": "simulated",
        **identity,
        "packages": {name: metadata.version(name) for name in PACKAGES}
        | {"o2-monitor": monitor.__version__},
        "reached": len(rows),
        "planned": study.count,
        "errors": sum(r["error"] is not None for r in rows),
        "targets": [
            asdict(t) | {"met": t.met, "proved": t.proved} for t in assess(rows, study.base)
        ],
        "two": tables.two(rows),
        "confusion": tables.confusion(rows),
        "by_size": [asdict(cell) for cell in tables.by_size(rows)],
        "wrong": [
            {k: r[k] for k in ("number", "kind", "vehicle", "hidden", "fault", "names")}
            for r in tables.wrong(rows)
        ],
    }


def as_text(rows: Sequence[Row], study: Study) -> str:
    """Return reached, targets, wrong names and errors as lines."""
    lines = [reached(rows, study)]
    for target in assess(rows, study.base):
        what, want, got, bounds, cases, verdict = cells(target)
        lines.append(f"{what}: {got} ({bounds}) of {cases}, wanted {want}: {verdict}")
    if found := tables.two(rows):
        lines.append("two effects: " + ", ".join(f"{n} {what}" for what, n in found.items()))
    big = [c for c in tables.by_size(rows) if c.size == CLASSES[2]]
    if big:
        each = ", ".join(f"{c.effect} {c.right}/{c.cases}" for c in big)
        lines.append(f"named rightly at a gap of at least twice the noise: {each}")
    lines += [
        f"wrong name: case {r['number']}, {hidden(r)}, gap {r['gap_over_noise']:.1f} times the "
        f"noise: {' + '.join(r['names'])}"
        for r in tables.wrong(rows)
    ]
    errors = Counter(r["error"] for r in rows if r["error"] is not None)
    lines += [f"error in {n} cases: {error}" for error, n in errors.most_common(ERRORS_SHOWN)]
    return "\n".join(lines)


def reached(rows: Sequence[Row], study: Study) -> str:
    """Return how far the study came."""
    errors = sum(r["error"] is not None for r in rows)
    failed = f", {errors} of them ended in an error and answer nothing" if errors else ""
    return (
        f"{len(rows)} of {study.count} simulated cases reached, base {study.base}, "
        f"{study.vehicles} vehicles{failed}"
    )


def cells(target: Target) -> tuple[str, str, str, str, str, str]:
    """Return a target as cells: what and where, wanted, found, bounds, cases, verdict."""
    sign = "≥" if target.at_least else "≤"
    return (
        f"{target.where}: {target.what}",
        f"{sign} {_number(target, target.wanted)}",
        _number(target, target.found),
        f"{_number(target, target.low)} to {_number(target, target.high)}",
        str(target.cases),
        target.verdict,
    )


def hidden(row: Row) -> str:
    """Return the hidden effects or fault with severity."""
    if row["fault"]:
        return f"{row['kind']}: {row['fault']} {row['fault_severity']:g}"
    effects = zip(row["hidden"], row["severities"], strict=True)
    return " + ".join(f"{name} {severity:g}" for name, severity in effects) or "nothing"


def _number(target: Target, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{100.0 * value:.1f} %" if target.unit == "share" else f"{value:.1f} s"
