"""What comes of reading a log: its frames, what was counted, its error."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import can
import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock
from monitor.frames import blocks
from monitor.frames.blf.structure import header_of, objects
from monitor.frames.blocks import LATEST_S, CutShortError, LogCounters
from monitor.frames.bounds import open_text
from monitor.frames.logs import frame_of, guarded, read_blocks
from monitor.frames.text.layouts import frame_of_line
from monitor.frames.text.lines import CUT_SHORT

Outcome = tuple[list[Frame], LogCounters, str | None]


def frames_of(block: FrameBlock) -> list[Frame]:
    """Return the frames of a block in the form that every reader gives."""
    assert (block.t_ns.dtype, block.key.dtype) == (np.int64, np.uint32)
    assert (block.length.dtype, block.data.dtype) == (np.uint8, np.uint8)
    assert block.data.shape in {(len(block.t_ns), 8), (len(block.t_ns), 64)}
    assert block.data.flags.c_contiguous
    behind = np.arange(block.data.shape[1]) >= block.length[:, np.newaxis]
    assert not block.data[behind].any()
    return list(blocks.frames_of(block))


def outcome(frames: Iterable[Frame], counters: LogCounters) -> Outcome:
    found: list[Frame] = []
    try:
        found.extend(frames)
    except RecordingError as error:
        return found, counters, str(error)
    return found, counters, None


def streamed(path: Path) -> Outcome:
    """Read a candump log line by line."""
    counters = LogCounters()

    def frames() -> Iterator[Frame]:
        with open_text(path, newline="") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith(("\n", "\r")):
                    raise CutShortError(CUT_SHORT)
                yield from frames_of_line(number, line, counters)

    return outcome(guarded(path, counters, frames()), counters)


def frames_of_line(number: int, line: str, counters: LogCounters) -> Iterator[Frame]:
    if not line.strip():
        return
    try:
        frame = frame_of_line(line.strip())
    except ValueError:
        counters.leave_out(number, line, "'(seconds) channel id#data' is wanted")
        return
    if frame is None:
        counters.skipped += 1
    else:
        counters.frames += 1
        yield frame


def python_can_reads(path: Path) -> Outcome:
    """Read a BLF with python-can's reader, and tell whether it ends too early."""
    counters = LogCounters()

    def frames() -> Iterator[Frame]:
        early: Exception | None = None
        with path.open("rb") as file:
            try:
                list(objects(file, header_of(file)))
            except (CutShortError, EOFError) as error:
                early = error
        with can.LogReader(path) as reader:
            for message in reader:
                if message.is_error_frame or message.is_remote_frame:
                    counters.skipped += 1
                    continue
                is_short = not message.is_fd and message.dlc > 8 == len(message.data)
                length = 8 if is_short else message.dlc
                if len(message.data) != length:
                    raise ValueError(f"a frame of {length} bytes holds only {len(message.data)}")
                if message.arbitration_id >> 29:
                    name = f"{message.arbitration_id:#X}, CAN has 29 bits at most"
                    raise ValueError(f"a frame with identifier {name}")
                if not -LATEST_S < message.timestamp < LATEST_S:
                    raise ValueError(f"a frame at {message.timestamp:g} s")
                counters.frames += 1
                yield frame_of(message)
        if early:
            raise early

    return outcome(guarded(path, counters, frames()), counters)


def read_at_once(path: Path) -> Outcome:
    counters = LogCounters()
    found = read_blocks(path, counters)
    return outcome((frame for block in found for frame in frames_of(block)), counters)


START_NS = 1_700_000_000_123_456_000


def synthetic(n: int) -> FrameBlock:
    rng = np.random.default_rng(n)
    return FrameBlock(
        START_NS + np.arange(n) * 250_000,
        rng.integers(0, 0x7FF, n, dtype=np.uint32),
        np.full(n, 8, dtype=np.uint8),
        rng.integers(0, 256, (n, 8)).astype(np.uint8),
    )
