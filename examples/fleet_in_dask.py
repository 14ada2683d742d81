"""A fleet on a Dask cluster, and what queries find in its results.

    python examples/fleet_in_dask.py [SCHEDULER]

Twelve drives of four vehicles, made from the simulated drives in ``replay_logs``, are judged by two
workers in this process, or by those of a scheduler (``tcp://scheduler:8786``) that see the folder
for temporary files.
"""

import sys
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import polars as pl
from distributed import LocalCluster

from training import load_recordings
from training.cli import main as o2train

LOGS = Path(__file__).parent.parent / "replay_logs"
MODEL = LOGS.parent / "monitor/model/shipped.onnx"
FIRST_DAY = datetime(2026, 3, 2, 7, 30, tzinfo=UTC)
FLEET = {  # the kind of each vehicle's drive, day by day
    "taxi_17": ("healthy", "healthy", "slow_symmetric"),
    "taxi_18": ("delay_rich_to_lean", "delay_rich_to_lean", "healthy"),
    "van_3": ("healthy", "healthy", "healthy"),
    "van_4": ("gain_low", "gain_low", "gain_low"),
}
CODES = """
SELECT vehicle, CAST(start AS DATE) AS day, codes[1] AS code, faults[1] AS fault, states[1] AS state
FROM recordings WHERE fault_flag ORDER BY vehicle, start
"""
RESIDUALS = """
SELECT vehicle, COUNT(*) AS n, AVG(mean) AS mean, SQRT(AVG(std * std)) AS std
FROM windows WHERE CAST(start AS DATE) >= CAST('2026-03-03' AS DATE)
GROUP BY vehicle ORDER BY vehicle
"""  # of the last two days


def drives(folder: Path) -> Path:
    """Write each drive as a table with times in UTC; return the manifest that names vehicles."""
    rows = ["path,vehicle"]
    for number, (vehicle, kinds) in enumerate(FLEET.items()):
        for day, kind in enumerate(kinds):
            [drive] = load_recordings(next(LOGS.glob(f"{kind}_micro_trips_*.blf")))
            begin_s = (FIRST_DAY + timedelta(days=day, minutes=number)).timestamp()
            columns = dict(zip(drive.names, drive.values.T, strict=True))
            path = folder / f"{vehicle}_{day + 1}.parquet"
            pl.DataFrame({"time_s": begin_s + drive.t_s, **columns}).write_parquet(path)
            rows.append(f"{path.name},{vehicle}")
    manifest = folder / "fleet.csv"
    manifest.write_text("\n".join(rows) + "\n")
    return manifest


def judge(manifest: Path, scheduler: str) -> Path:
    """Judge the fleet; return the table of its recordings."""
    results = manifest.parent / "results.parquet"
    command = ["fleet", str(manifest), "--model", str(MODEL), "--scheduler", scheduler]
    if o2train([*command, "--out", str(results)]) != 0:
        sys.exit("the fleet could not be judged")
    return results


def found(query: str, results: Path) -> list[tuple[Any, ...]]:
    """Return the rows of a query over the results."""
    windows = results.with_suffix(".windows.parquet")
    tables = {"recordings": pl.scan_parquet(results), "windows": pl.scan_parquet(windows)}
    return pl.SQLContext(tables, eager=True).execute(query).rows()


def main(scheduler: str | None) -> None:
    """Write the drives, judge them, and print what the queries find."""
    with tempfile.TemporaryDirectory() as name:
        manifest = drives(Path(name))
        if scheduler is not None:
            results = judge(manifest, scheduler)
        else:
            with LocalCluster(
                2, threads_per_worker=1, processes=False, dashboard_address=None
            ) as own:
                results = judge(manifest, own.scheduler_address)
        print("\nDays with a code:")
        for vehicle, day, code, fault, state in found(CODES, results):
            print(f"  {vehicle} {day}: {code} {fault}, {state}")
        print("\nResidual of the last two days:")
        for vehicle, n, mean, std in found(RESIDUALS, results):
            print(f"  {vehicle}: {n} windows, mean {mean:+.4f}, standard deviation {std:.4f}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
