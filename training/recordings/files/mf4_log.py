"""CAN logs as MDF 4, all frames at once; python-can's writer takes 0.1 ms for each."""

import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FrameBlock
from monitor.frames import mdf as mdf4
from monitor.frames.blocks import EXTENDED
from training.recordings.files.measurement import asammdf_for

_NAME: Final = "CAN_DataFrame"  # names and layout: ASAM MDF, associated standard for bus logging
_DTYPE: Final = np.dtype(
    [
        (f"{_NAME}.BusChannel", "<u1"),
        (f"{_NAME}.ID", "<u4"),
        (f"{_NAME}.IDE", "<u1"),
        (f"{_NAME}.DLC", "<u1"),
        (f"{_NAME}.DataLength", "<u1"),
        (f"{_NAME}.DataBytes", "(8,)u1"),
        (f"{_NAME}.Dir", "<u1"),
    ]
)


def write_mf4(path: Path, frames: FrameBlock) -> None:
    """Write the frames to an .mf4 file; its start time is the first frame's whole second.

    Raises RecordingError if asammdf is not installed.
    """
    asammdf = asammdf_for(path, "writing")
    from asammdf.blocks.v4_blocks import SourceInformation  # noqa: PLC0415
    from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS  # noqa: PLC0415

    start_s = int(frames.t_ns[0]) // 1_000_000_000
    samples = np.zeros(len(frames.t_ns), dtype=_DTYPE)
    samples[f"{_NAME}.BusChannel"] = 1
    samples[f"{_NAME}.ID"] = frames.key & (EXTENDED - 1)
    samples[f"{_NAME}.IDE"] = frames.key >= EXTENDED
    samples[f"{_NAME}.DLC"] = samples[f"{_NAME}.DataLength"] = frames.length
    samples[f"{_NAME}.DataBytes"] = frames.data
    with path.open("wb"):  # an unwritable place is told before any work
        pass
    with mdf4.quiet(), asammdf.MDF(version="4.10") as mdf:
        mdf.header.start_time = datetime.fromtimestamp(start_s, tz=UTC)
        mdf.append(
            asammdf.Signal(
                name=_NAME,
                samples=samples,
                timestamps=(frames.t_ns // 1000 - start_s * 1_000_000) / 1e6,
                source=SourceInformation(source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN),
            )
        )
        mdf.save(path, overwrite=True, compression=2)
    _set_history_time(path, start_s)


def _set_history_time(path: Path, start_s: int) -> None:
    """Replace the clock's time in the file history, so that the same frames give the same bytes.

    Layout: ASAM MDF 4.1, header block at byte 64, its second link leads to the first file history.
    """
    with path.open("r+b") as file:
        file.seek(64 + 24 + 8)
        (history,) = struct.unpack("<Q", file.read(8))
        file.seek(history)
        if file.read(4) != b"##FH":
            raise RecordingError(f"{path}: the file history is not where the header says")
        file.seek(history + 24 + 2 * 8)
        file.write(struct.pack("<Q", start_s * 1_000_000_000))
