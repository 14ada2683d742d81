"""Files of simulated drives; the file name lists cycle, vehicle, seed, fault and effects."""

from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.files import manifest
from training.dyno import downstream, ecu, logger
from training.dyno.simulation import Experiment, simulate
from training.recordings.files.can_log import write_log
from training.recordings.recording import write_table

TABLES = ("parquet", "csv", "csv.gz")


def write(experiment: Experiment, folder: Path, suffix: str, period_s: float = 0.1) -> Path:
    """Simulate one drive, write it and its manifest entry into ``folder``, and return the path.

    suffix : "log", "blf", "asc", "trc" or "mf4" for a CAN log of the project's ECU; "parquet",
        "csv" or "csv.gz" for a table on a sample grid of ``period_s``; the table of an experiment
        with a layout holds the answers of its ECU every ``period_s``
    Raises UsageError for an unknown cycle or a file in the way that is no simulated drive,
    RecordingError if the file cannot be written.
    """
    path = folder / f"{experiment.name}.{suffix}"
    if path.exists() and manifest.entry_of(path).get("source") != "simulated":
        raise UsageError(f"{path}: is there already and no simulated drive; choose another folder")
    layout = experiment.layout if suffix in TABLES else None
    if layout is not None and experiment.downstream:
        raise UsageError(f"{path}: a tuner's log has no sensor behind the catalyst, a CAN log has")
    signals = simulate(experiment)
    if layout is not None:
        names = logger.columns(layout)
        t_s, values = logger.polled(signals, names, period_s)
        write_table(path, t_s, names, values)
    else:
        bus_map = ecu.own_bus()
        rng = np.random.default_rng([0x0_2, 5, experiment.seed, experiment.vehicle])
        sent = ecu.broadcast(signals, bus_map, rng, experiment.fault, experiment.fault_start_s)
        if suffix in TABLES:
            block = ecu.samples(sent, bus_map, round(period_s * 1e9))
            write_table(path, block.t_ns / 1e9, ecu.names_of(sent, bus_map), block.values)
        else:
            write_log(path, ecu.frames(sent))
    entries = manifest.load(path.parent)
    manifest.save(path.parent, entries | {path.name: describe(experiment, path)})
    return path


def describe(experiment: Experiment, path: Path) -> dict[str, Any]:
    """Return the manifest entry of a simulated drive."""
    fault = experiment.downstream_fault or experiment.fault
    behind = {}
    if experiment.downstream:
        rear = downstream.installed(experiment.vehicle, experiment.downstream_fault, 0.0, 0.0)
        behind = {"downstream": True, "catalyst_capacity_g": round(rear.capacity_g, 4)}
    return {
        "file": path.name,
        "sha256": manifest.sha256_of(path),
        "source": "simulated",
        "cycle": experiment.cycle,
        "vehicle": experiment.vehicle,
        "seed": experiment.seed,
        "fault": fault.name if fault else None,
        "severity": fault.severity if fault else None,
        "fault_start_s": experiment.fault_start_s if fault else None,
        "in_the_loop": bool(fault),
        "effects": {k: v for k, v in experiment.effects._asdict().items() if v},
        **behind,
        **({"layout": experiment.layout.name} if experiment.layout else {}),
    }
