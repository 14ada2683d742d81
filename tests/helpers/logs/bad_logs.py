"""A short simulated drive as a log, to be spoilt."""

from pathlib import Path

import numpy as np

from monitor.base.types import Frame
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.recordings.files.frame_block import EncodedFrames

LAMBDA_ID, FUEL_ID = 0xC2, 0xC1


def write_minute(folder: Path) -> Path:
    """Write one minute of a simulated drive."""
    return write(
        Experiment(cycle="micro_trips", vehicle=50, seed=50, duration_s=60.0), folder, "log"
    )


def block(frames: list[Frame]) -> EncodedFrames:
    """Return frames side by side."""
    data = np.zeros((len(frames), 8), dtype=np.uint8)
    for row, frame in zip(data, frames, strict=True):
        row[: len(frame.data)] = list(frame.data)
    return EncodedFrames(
        np.array([f.t_ns for f in frames]),
        np.array([f.can_id for f in frames]),
        np.array([f.is_extended for f in frames]),
        np.array([len(f.data) for f in frames]),
        data,
    )
