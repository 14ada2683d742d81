"""Real logs without a model: electrical faults put on the reading, judged by the electrical tests.

FOLDER holds logs of tuning tools, at any depth. Every log with a wideband reading and the engine's
speed is judged as it is, and with each fault.

    python benchmarks/logs_without_model.py FOLDER [--profiles DIR]

A profile in DIR (default: ``profiles`` beside this file) with the name of a file is given with it.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.config import load
from monitor.base.errors import MissingSignalsError, O2Error
from monitor.base.signals import OUTPUT
from monitor.grid.tables import Table, is_table, read_table
from monitor.judge.readiness import ENGINE
from monitor.memory.dtc_store import DtcStore
from monitor.report import without_model

LEAST_S: Final = 60.0
FAULTS: Final = {  # reading, and the share of the log from which on it is put on
    "lean rail": (2.0, 1 / 3),
    "rich rail": (0.503, 1 / 3),
    "its last value": (None, 1 / 3),
    "dead from the start": (1.517, 0.0),
}


def codes(table: Table, begin_s: float) -> str:
    store = DtcStore()
    store.start_driving_cycle()
    found = without_model.judge(table, store, load(), MissingSignalsError("no model"))["dtcs"]
    return ", ".join(f"{d['fault']} {d['t_s'] - begin_s:.0f} s" for d in found) or "-"


def faulty(table: Table, reads: float | None, share: float) -> tuple[Table, float]:
    """Return the table with readings that stand still, and from when on in s."""
    begin, place = round(share * len(table.t_ns)), table.names.index(OUTPUT)
    values = table.values.copy()
    values[begin:, place] = values[begin, place] if reads is None else reads
    begin_s = float(table.t_ns[begin] - table.t_ns[0]) / 1e9
    return replace(table, values=values, pinned=None), begin_s


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--profiles", type=Path, default=Path(__file__).parent / "profiles")
    args = parser.parse_args()
    for path in sorted(p for p in args.folder.rglob("*") if p.is_file() and is_table(p)):
        own = args.profiles / f"{path.name.split('.')[0]}.toml"
        try:
            table = read_table(path, own if own.is_file() else None)
        except O2Error:
            continue
        span_s = np.ptp(table.t_ns) / 1e9
        if not {OUTPUT, ENGINE} <= set(table.names) or span_s < LEAST_S:
            continue
        print(f"{path.name}, {span_s:.0f} s: as it is: {codes(table, 0.0)}")
        for name, (reads, share) in FAULTS.items():
            print(f"    {name}: {codes(*faulty(table, reads, share))}")


if __name__ == "__main__":
    main()
