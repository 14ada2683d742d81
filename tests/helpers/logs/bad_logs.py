"""A short simulated drive as a log, to be spoilt."""

from pathlib import Path

from training.dyno.recording_files import write
from training.dyno.simulation import Experiment

LAMBDA_ID, FUEL_ID = 0xC2, 0xC1


def write_minute(folder: Path) -> Path:
    """Write one minute of a simulated drive."""
    return write(
        Experiment(cycle="micro_trips", vehicle=50, seed=50, duration_s=60.0), folder, "log"
    )
