"""Simulated drives as tables and CAN logs, for tests of the command ``o2train gap``."""

from collections.abc import Sequence
from pathlib import Path

from monitor.base.faults import resolve
from training import cli
from training.dyno.effects import from_severities
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment

VEHICLE = 2001
CYCLES = ("micro_trips", "udds", "wltc_3b", "us06")


def drives(
    folder: Path,
    seed: int,
    effect: tuple[str, float] | None = None,
    fault: tuple[str, float] | None = None,
    suffixes: Sequence[str] = ("parquet", "parquet", "parquet"),
) -> list[Path]:
    """Write drives of 400 s with the same effect or fault in each; return their paths."""
    return [
        write(
            Experiment(
                cycle=cycle,
                vehicle=VEHICLE,
                seed=seed + i,
                effects=from_severities(dict([effect] if effect else [])),
                fault=resolve(*fault) if fault else None,
                duration_s=400.0,
            ),
            folder,
            suffix,
        )
        for i, (cycle, suffix) in enumerate(zip(CYCLES, suffixes, strict=False))
    ]


def run(*arguments: str | Path) -> int:
    """Run ``o2train gap``; return the exit code."""
    return cli.main(["gap", *map(str, arguments)])
