"""Figures of a fleet from its tables: codes, outliers, limits, failed recordings, cost."""

import re
from collections.abc import Mapping
from typing import Any, Final

import polars as pl

import monitor
from monitor.judge.enable import CONDITIONS
from training.fleet.page import outliers
from training.fleet.page.outliers import Standing
from training.limits.rates import Figures, per_1000_h, rate

SCHEMA: Final = "o2train.fleet/1"
EXAMPLES: Final = 3  # files per reason, vehicles per code


def summary(recordings: pl.DataFrame, run: Mapping[str, Any], found: list[Standing]) -> Figures:
    """Return the whole result of a fleet as JSON values.

    recordings : the table of recordings
    run : identity and cost of the run, from ``run.run``
    found : statistics over the vehicles, from ``outliers.standings``
    """
    judged = recordings.filter(pl.col("error").is_null())
    return {
        "schema": SCHEMA,
        **run,
        "o2_monitor": monitor.__version__,
        "hours": _sum(judged, "duration_s") / 3600.0,
        "enabled_hours": _sum(judged, "enabled_s") / 3600.0,
        "vehicles": recordings["vehicle"].n_unique(),
        "judged": len(judged),
        "completed": rate(int(judged["completed"].sum()), len(judged)),
        "windows": int(_sum(judged, "windows")),
        "simulated": int((judged["source"] == "simulated").sum()),
        "with_code": rate(int(judged["fault_flag"].sum()), len(judged)),
        "codes": codes(judged),
        "drives_with_code": drives_with_code(judged),
        "standing_out": {
            "chance": outliers.RATE,
            "statistics": [_standing(standing) for standing in found],
        },
        "not_judged": reasons(recordings),
        "not_completed": not_completed(judged),
        "per_1000_h": cost(run),
    }


def codes(judged: pl.DataFrame) -> list[Figures]:
    """Return all codes that are set, the most frequent first, with up to 3 of their vehicles."""
    if not judged["fault_flag"].any():
        return []
    every = judged.select("vehicle", "recording", "codes", "faults", "states").explode(
        "codes", "faults", "states"
    )
    groups = every.drop_nulls("codes").group_by("codes", "faults")
    table = groups.agg(
        drives=pl.col("recording").n_unique(),
        vehicles=pl.col("vehicle").n_unique(),
        confirmed=(pl.col("states") == "confirmed").sum(),
        examples=pl.col("vehicle").unique(maintain_order=True).head(EXAMPLES),
    ).sort(["drives", "codes", "faults"], descending=[True, False, False])
    seconds = _sum(judged, "duration_s")
    return [
        {
            "code": row["codes"],
            "fault": row["faults"],
            **{k: row[k] for k in ("drives", "vehicles", "confirmed", "examples")},
            "rate": per_1000_h(row["drives"], seconds),
        }
        for row in table.to_dicts()
    ]


def drives_with_code(judged: pl.DataFrame) -> list[Figures]:
    """Return each drive that ends with a code, by vehicle and then in the given order."""
    order = {vehicle: i for i, vehicle in enumerate(judged["vehicle"].unique(maintain_order=True))}
    columns = ("vehicle", "start", "path", "codes", "faults", "states", "first_code_s", "source")
    rows = judged.filter(pl.col("fault_flag")).select(columns).to_dicts()
    return [
        {**row, "start": row["start"].isoformat() if row["start"] else None}
        for row in sorted(rows, key=lambda row: order[row["vehicle"]])
    ]


def reasons(recordings: pl.DataFrame) -> list[Figures]:
    """Return the reasons of recordings that were not judged, the most frequent first.

    Reasons that differ only in numbers are one, N where they differ, with up to 3 example files.
    """
    alike: dict[tuple[str, ...], list[list[str]]] = {}  # by words: path, words and numbers
    bad = recordings.filter(pl.col("error").is_not_null())
    for path, error in bad.select("path", "error").iter_rows():
        parts = re.split(r"(\b\d[\d.]*\b)", str(error).removeprefix(f"{path}: "))
        alike.setdefault(tuple(parts[::2]), []).append([path, *parts])
    rows: list[Figures] = []
    for paths, *told in (zip(*each, strict=True) for each in alike.values()):
        reason = "".join(part[0] if len({*part}) == 1 else "N" for part in told)
        rows.append({"reason": reason, "recordings": len(paths), "examples": [*paths[:EXAMPLES]]})
    return sorted(rows, key=lambda row: -int(str(row["recordings"])))


def not_completed(judged: pl.DataFrame) -> Figures:
    """Return the number of drives without a decision, and how often their conditions held."""
    undecided = judged.filter(~pl.col("completed"))
    held = undecided.select(pl.col(f"held_{name}").mean() for name in CONDITIONS).to_dicts()
    shares = held[0] if held else {}
    return {
        "drives": len(undecided),
        "without_window": int((undecided["windows"] == 0).sum()),
        "held": {name: shares.get(f"held_{name}") for name in CONDITIONS},
    }


def cost(run: Mapping[str, Any]) -> Figures | None:
    """Return processor seconds by step, and bytes, per 1,000 hours of driving.

    The result is None if nothing was driven.
    """
    hours = float(run["driving_s"]) / 3600.0
    if hours <= 0.0:
        return None
    scale = 1000.0 / hours
    steps = {step: seconds * scale for step, seconds in run["seconds"].items()}
    return {
        "core_seconds": steps | {"all": sum(steps.values())},
        "read_bytes": run["size_bytes"] * scale,
        "written_bytes": run["written_bytes"] * scale,
        "times_real_time": float(run["driving_s"]) / max(sum(run["seconds"].values()), 1e-9),
    }


def _standing(standing: Standing) -> Figures:
    return {
        "statistic": standing.statistic.column,
        "vehicles": len(standing.vehicles),
        "limit": standing.limit,
        "out": [
            {
                "vehicle": standing.vehicles[i],
                "value": float(standing.values[i]),
                "distance": max(min(float(standing.distance[i]), 1e9), -1e9),  # no infinity
            }
            for i in standing.out
        ],
    }


def _sum(table: pl.DataFrame, column: str) -> float:
    return float(table[column].sum() or 0.0)
