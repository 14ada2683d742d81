"""The result of a matrix as JSON and as the lines that the command prints."""

import platform
from collections.abc import Sequence
from importlib import metadata
from typing import Any, Final

import monitor
from benchmarks.studies.rules.alarms import FALSE_ALARM_RATE
from benchmarks.studies.sensor import tables
from benchmarks.studies.sensor.plan import CALIBRATION_SEED, CALIBRATION_VEHICLES, PLACEMENTS
from benchmarks.studies.sensor.rows import Row
from benchmarks.studies.sensor.targets import assess
from training.limits.rates import Figures
from training.limits.tolerance import CONFIDENCE

SCHEMA: Final = "o2train.matrix/1"
PACKAGES: Final = ("numpy", "scipy", "numba", "onnxruntime")


def result(rows: Sequence[Row], identity: dict[str, Any], model: str) -> Figures:
    """Return the whole result of a run.

    identity : what the run depends on, as ``run.identity`` gives it
    """
    faulty = tables.of_kind(rows, "faulty")
    return {
        "schema": SCHEMA,
        "source": "simulated",
        "model": model,
        **identity,
        "packages": {name: metadata.version(name) for name in PACKAGES}
        | {"o2-monitor": monitor.__version__, "python": platform.python_version()},
        "confidence": CONFIDENCE,
        "drives": {
            "all": len(rows),
            "hours": sum(r["driving_s"] for r in rows) / 3600.0,
            **{k: len(tables.of_kind(rows, k)) for k in ("reference", "healthy", "faulty")},
        },
        "rules_set_on": {
            "vehicles": [CALIBRATION_VEHICLES[0], CALIBRATION_VEHICLES[-1]],
            "first_seed": CALIBRATION_SEED,
            "false_alarm_rate": FALSE_ALARM_RATE,
        },
        "faulty_cycles": sorted({r["cycle"] for r in faulty}),
        "targets": assess(rows),
        "healthy": tables.healthy(rows),
        "detection": tables.detection(rows),
        "by_ambient": tables.by_ambient(rows),
        "confusion": {p: tables.confusion(rows, p) for p in PLACEMENTS},
        "roc": tables.curves(rows),
        "rules": tables.side_by_side(rows),
    }


def as_text(found: Figures) -> str:
    """Return the targets as lines."""
    n, lines = found["drives"], []
    lines.append(
        f"{n['all']} simulated drives, {n['hours']:.0f} h: {n['reference']} that vehicles' "
        f"references learn from, {n['healthy']} healthy, {n['faulty']} faulty"
    )
    for each in found["targets"]:
        what, where, want, got, bounds, _, verdict = cells(each)
        lines.append(f"{what}, {where}: {got} ({bounds}), wanted {want}: {verdict}")
    false = found["healthy"]["all"]["false_1000_h"]
    if false["per_1000_h"] is not None:
        lines.append(
            f"false alarms per 1,000 driving hours: {false['per_1000_h']:.3g}, at most "
            f"{false['high']:.3g} with 95 % confidence"
        )
    return "\n".join(lines)


def cells(target: Figures) -> tuple[str, ...]:
    """Return a target as cells: what, where, wanted, found, 95 % bounds, drives, verdict."""
    unit = target["unit"]
    sign = {"share": "≥ ", "s": "≤ ", "drives": ""}[unit]
    found = "never" if unit == "s" and target["trials"] else "-"
    if target["found"] is not None:
        found = number(target["found"], unit)
    low, high = (
        number(target[k], unit) if target[k] is not None else "never" if unit == "s" else "-"
        for k in ("low", "high")
    )
    return (
        target["what"],
        target["where"],
        sign + number(target["wanted"], unit),
        found,
        f"{low} to {high}",
        str(target["trials"]),
        verdict(target),
    )


def verdict(target: Figures) -> str:
    """Return whether a target is met, and by how much it is missed."""
    if target["met"] is None:
        return f"not judged: {target['why']}"
    if target["met"]:
        return "met" if target["proved"] is not False else "met, the bound does not prove it"
    unit = target["unit"]
    if target["missed_by"] is None:
        return "missed: more than half of the drives set no code"
    by = number(target["missed_by"], unit).replace(" %", " percentage points")
    return f"missed by {by}"


def number(value: float, unit: str) -> str:
    """Return a share in percent, a time in seconds, a count as it is."""
    if unit == "share":
        return f"{100.0 * value:.1f} %"
    return f"{value:.0f} s" if unit == "s" else f"{value:.3g}"
