"""Make the recordings of this folder, their manifest and the expected events.

    python replay_logs/make.py             everything
    python replay_logs/make.py --behind    only the drives with a catalyst, and all expected events
    python replay_logs/make.py --expected  only the expected events, after a change of the monitor

All drives are simulated. Their vehicles and seeds are used by no training: training uses vehicle 1
and seeds from 1001 on.
"""

import argparse
import os
import sys
from pathlib import Path

from monitor import cli
from monitor.base import faults
from monitor.base.files import manifest
from training.dyno import vehicle
from training.dyno.downstream import fault_behind
from training.dyno.recording_files import describe, write
from training.dyno.simulation import Experiment

HERE = Path(__file__).parent
FIRST_VEHICLE, FIRST_SEED = 101, 101
FIRST_BEHIND = 150  # vehicles and seeds with a sensor behind the catalyst follow
BEHIND = {  # faults and the length of their drives in s
    "catalyst_low": 420.0,
    "downstream_slow_rich_to_lean": 420.0,
    "downstream_low": 90.0,
    "downstream_high": 90.0,
    "downstream_inactive": 90.0,
    "downstream_heater": 90.0,
}
RESPONSE_S, SHORT_S = 420.0, 150.0  # length of a drive: response faults and healthy, other faults
SEVERITY = {"drift_lean": 0.9, "drift_rich": 0.8}  # beyond the limit within the drive
FAULT_START_S = {"signal_missing": 60.0}


def experiments() -> list[tuple[str, Experiment]]:
    """Return (file stem, drive): two healthy drives and one per fault, warm at the start."""
    seeds = (
        s for s in range(FIRST_SEED, 10_000) if vehicle.conditions(s).coolant_start_degc > 66.0
    )
    number = FIRST_VEHICLE
    chosen = [("healthy_wltc_3b", Experiment(vehicle=number, seed=next(seeds)))]
    for name in ("healthy", *faults.NAMES):
        number += 1
        fault = None if name == "healthy" else faults.resolve(name, SEVERITY.get(name))
        short = fault is not None and bool(fault.stuck_lambda or fault.not_ready or fault.missing)
        chosen.append(
            (
                f"{name}_micro_trips",
                Experiment(
                    cycle="micro_trips",
                    vehicle=number,
                    seed=next(seeds),
                    fault=fault,
                    fault_start_s=FAULT_START_S.get(name, 0.0),
                    duration_s=SHORT_S if short else RESPONSE_S,
                ),
            )
        )
    return chosen


def behind() -> list[tuple[str, Experiment]]:
    """Return (file stem, drive) with a sensor behind the catalyst, warm at the start."""
    drives = {None: RESPONSE_S, **{fault_behind(n): s for n, s in BEHIND.items()}}
    number, seed = FIRST_BEHIND, FIRST_BEHIND
    chosen = []
    for fault, duration_s in drives.items():
        number, seed = number + 1, seed + 1
        while vehicle.conditions(seed).coolant_start_degc < 66.0:
            seed += 1
        drive = Experiment(
            cycle="micro_trips",
            vehicle=number,
            seed=seed,
            duration_s=duration_s,
            downstream=True,
            downstream_fault=fault,
        )
        chosen.append((f"{fault.name if fault else 'healthy_downstream'}_micro_trips", drive))
    return chosen


def make_recordings(experiments: list[tuple[str, Experiment]]) -> None:
    """Write logs and their entries of the manifest."""
    for stem, experiment in experiments:
        written = write(experiment, HERE, "blf")
        path = written.rename(HERE / f"{stem}_v{experiment.vehicle}_s{experiment.seed}.blf")
        entries = manifest.load(HERE)
        del entries[written.name]
        fault = experiment.fault or experiment.downstream_fault
        name = fault.name if fault else None
        entry = describe(experiment, path) | {
            "expected": {"fault": name, "exit_code": int(bool(name))}
        }
        manifest.save(HERE, entries | {path.name: entry})


def make_expected() -> int:
    """Replay every log with defaults and write its events; return the number of wrong verdicts."""
    wrong = 0
    os.chdir(HERE.parent)  # makes the paths in the results the same on every machine
    (HERE / "expected").mkdir(exist_ok=True)
    for name, entry in manifest.load(HERE).items():
        out = HERE / "expected" / f"{name}.json"
        code = cli.main(["replay", f"{HERE.name}/{name}", "--json", str(out)])
        wrong += code != entry["expected"]["exit_code"]
    return wrong


def main() -> int:
    """Run the script; return 1 if a verdict is wrong, otherwise 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--expected", action="store_true")
    parser.add_argument("--behind", action="store_true")
    args = parser.parse_args()
    if not (args.expected or args.behind):
        for old in (*HERE.glob("*.blf"), HERE / manifest.NAME):
            old.unlink(missing_ok=True)
        make_recordings(experiments())
    if not args.expected:
        make_recordings(behind())
    return int(make_expected() > 0)


if __name__ == "__main__":
    sys.exit(main())
