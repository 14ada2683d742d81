"""Recordings made of columns or of a simulated bus's samples."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from monitor.base.types import FloatArray, Quality, SampleBlock
from training.recordings.recording import Recording


def recording_of(
    columns: Mapping[str, FloatArray],
    name: str = "drive.csv",
    period_s: float = 0.1,
    sha256: str = "",
) -> Recording:
    """Return a recording of these columns; where one is NaN it is not valid."""
    values = np.column_stack(list(columns.values()))
    return Recording(
        path=Path(name),
        sha256=sha256 or name,
        period_ns=round(period_s * 1e9),
        t_s=np.arange(len(values)) * period_s,
        names=tuple(columns),
        values=values,
        quality=np.where(np.isnan(values), Quality.INVALID, Quality.GOOD).astype(np.uint8),
    )


def recording_of_samples(
    block: SampleBlock, names: Sequence[str], name: str = "simulated", sha256: str = ""
) -> Recording:
    made = recording_of(dict(zip(names, block.values.T, strict=True)), name, sha256=sha256)
    return replace(made, t_s=(block.t_ns - block.t_ns[0]) / 1e9, quality=block.quality)
