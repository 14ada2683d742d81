"""A fleet's tables as figures: what was found, what was not judged and why, what it cost."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import polars as pl

import monitor
from monitor.judge.enable import CONDITIONS
from training.fleet import outliers, proposal
from training.fleet.outliers import Standing
from training.limits.rates import Figures, per_1000_h, rate

SCHEMA: Final = "o2train.fleet/1"
EXAMPLES: Final = 3  # files named for each reason, vehicles for each code


def summary(
    recordings: pl.DataFrame,
    windows: Path,
    run: Mapping[str, Any],
    limits: Mapping[str, float],
    wished: float,
    found: list[Standing],
) -> Figures:
    """Return the whole result of a fleet.

    recordings, windows : the tables
    run : what the run rests on and what it cost, as ``run.run`` returns it
    limits : the model's present limits by name
    wished : false-alarm rate for the limits to propose
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
        "standing_out": {
            "chance": outliers.RATE,
            "statistics": [_standing(each) for each in found],
        },
        "limits": proposal.proposals(recordings, windows, wished, limits),
        "not_judged": reasons(recordings),
        "not_completed": not_completed(judged),
        "per_1000_h": cost(run),
    }


def codes(judged: pl.DataFrame) -> list[Figures]:
    """Return every code that is set, the most frequent first, with some of its vehicles."""
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


def reasons(recordings: pl.DataFrame) -> list[Figures]:
    """Return why recordings could not be judged, the most frequent first, with examples."""
    alike: dict[str, list[str]] = {}
    bad = recordings.filter(pl.col("error").is_not_null())
    for path, error in bad.select("path", "error").iter_rows():
        text = str(error).removeprefix(f"{path}: ")
        alike.setdefault(re.sub(r"\d+", "N", text), []).append(path)
    found = [
        {"reason": reason, "recordings": len(paths), "examples": paths[:EXAMPLES]}
        for reason, paths in alike.items()
    ]
    return sorted(found, key=lambda each: -int(str(each["recordings"])))


def not_completed(judged: pl.DataFrame) -> Figures:
    """Return how many drives reached no decision, and how often each condition held in them."""
    own = judged.filter(~pl.col("completed"))
    held = own.select(pl.col(f"held_{name}").mean() for name in CONDITIONS).to_dicts()
    shares = held[0] if held else {}
    return {
        "drives": len(own),
        "without_window": int((own["windows"] == 0).sum()),
        "held": {name: shares.get(f"held_{name}") for name in CONDITIONS},
    }


def cost(run: Mapping[str, Any]) -> Figures | None:
    """Return processor seconds, by step, and bytes for 1,000 hours of driving; None without any."""
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


def _standing(each: Standing) -> Figures:
    return {
        "statistic": each.statistic.column,
        "vehicles": len(each.vehicles),
        "limit": each.limit,
        "out": [
            {
                "vehicle": each.vehicles[i],
                "value": float(each.values[i]),
                "distance": _finite(float(each.distance[i])),
            }
            for i in each.out
        ],
    }


def _finite(value: float) -> float:
    return max(min(value, 1e9), -1e9)  # JSON knows no infinity


def _sum(table: pl.DataFrame, column: str) -> float:
    return float(table[column].sum() or 0.0)
