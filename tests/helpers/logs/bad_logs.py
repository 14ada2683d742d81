"""A short drive as a log, to be spoilt."""

from pathlib import Path

from tests.helpers.logs.injected_frames import first_minutes

LAMBDA_ID, FUEL_ID = 0xC2, 0xC1


def write_minute(folder: Path) -> Path:
    """Write one minute of a healthy drive."""
    return first_minutes(folder, 60.0)
