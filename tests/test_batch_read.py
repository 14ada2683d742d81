import gzip
from collections.abc import Iterable, Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.batch import candump
from monitor.batch.blocks import EXTENDED
from monitor.candump import LogCounters
from monitor.errors import RecordingError
from monitor.sources import guarded, open_binary, read_frames
from monitor.types import Frame, FrameBlock

Outcome = tuple[list[Frame], LogCounters, str | None]


def frames_of(block: FrameBlock) -> list[Frame]:
    assert (block.t_ns.dtype, block.key.dtype) == (np.int64, np.uint32)
    assert (block.length.dtype, block.data.dtype) == (np.uint8, np.uint8)
    assert block.data.shape in {(len(block.t_ns), 8), (len(block.t_ns), 64)}
    behind = np.arange(block.data.shape[1]) >= block.length[:, np.newaxis]
    assert not block.data[behind].any()
    return [
        Frame(t_ns, key & (EXTENDED - 1), bool(key & EXTENDED), data[:length])
        for t_ns, key, length, data in zip(
            block.t_ns.tolist(), block.key.tolist(), block.length.tolist(),
            map(bytes, block.data), strict=True,
        )
    ]  # fmt: skip


def outcome(frames: Iterable[Frame], counters: LogCounters) -> Outcome:
    found: list[Frame] = []
    try:
        found.extend(frames)
    except RecordingError as error:
        return found, counters, str(error)
    return found, counters, None


def streamed(path: Path) -> Outcome:
    counters = LogCounters()
    return outcome(read_frames(path, counters), counters)


def in_chunks(path: Path, chunk_bytes: int) -> Outcome:
    counters = LogCounters()

    def blocks() -> Iterator[FrameBlock]:
        with open_binary(path) as file:
            yield from candump.read_blocks(
                cast(BufferedIOBase, file), counters, chunk_bytes=chunk_bytes
            )

    found = guarded(path, counters, blocks())
    return outcome((frame for block in found for frame in frames_of(block)), counters)


HEX = "0123456789ABCDEFabcdef"
STAMP = st.one_of(
    st.integers(0, 2**32 * 10**6 - 1).map(lambda us: f"({us // 10**6}.{us % 10**6:06d})"),
    st.sampled_from(["(1700000000.123456)", "(1700000001.999999)", "(0.000001)", "(12.500000)"]),
    st.floats(0, 5e9).map(lambda t: f"({t:f})"),
    st.integers(0, 10**20).map(lambda ns: f"({ns // 10**9}.{ns % 10**9:09d})"),
    st.text("0123456789.()e-+_ ", max_size=20),
    st.sampled_from(["(1e300)", "(nan)", "(inf)", "(-1.000000)", "(9200000000.000000)", "(.5)"]),
)
CHANNEL = st.one_of(
    st.sampled_from(
        ["can0", "vcan12", "x", "a_very_long_channel_name_0", "kanal\u00a00", "\u00e4"]
    ),
    st.text('can0#!"\u2003', min_size=1, max_size=5),
)
IDENTIFIER = st.one_of(
    st.integers(0, 0xFFF).map("{:03X}".format),
    st.integers(0, 0xFFFFFFFF).map("{:08X}".format),
    st.integers(0, 0x1FFFFFFF).map("{:08x}".format),
    st.text(HEX + "x_+- G", max_size=9),
)
DATA = st.one_of(
    st.binary(max_size=8).map(lambda data: data.hex().upper()),
    st.binary(max_size=66).map(lambda data: "#1" + data.hex()),
    st.text(HEX, max_size=18),
    st.text(HEX + "GOg@`/:#RrT_ \u0660", max_size=20),
    st.sampled_from(["R", "r4", "R8", "##", "#", "#0", "###", "#1AB#", ""]),
)
TAIL = st.sampled_from(["", " R", " T", " ", "\t", " a b # c", "\u00a0R", "\x1f", "  "])
PLAIN = st.builds(
    lambda us, can_id, data: f"({us // 10**6}.{us % 10**6:06d}) can0 {can_id}#{data.hex().upper()}",
    st.integers(10**15, 2 * 10**15),
    st.one_of(
        st.integers(0, 0x7FF).map("{:03X}".format), st.integers(0, 2**29).map("{:08X}".format)
    ),
    st.binary(max_size=8),
)
LINE = st.one_of(
    PLAIN,
    PLAIN,
    st.builds(
        lambda *parts: "{} {} {}#{}{}".format(*parts), STAMP, CHANNEL, IDENTIFIER, DATA, TAIL
    ),
    st.sampled_from(["", " ", "\t", "(1.0) can0", "hello world again", "\x00", "\x0b", "\x85"]),
)
END = st.sampled_from(["\n"] * 6 + ["\r\n", "\r", "\n\n"])


@st.composite
def texts(draw: st.DrawFn) -> bytes:
    """Draw candump text, mostly as it should be, sometimes spoilt."""
    lines = draw(st.lists(st.tuples(st.one_of(PLAIN, LINE), END), max_size=30))
    text = bytearray("".join(line + end for line, end in lines).encode())
    if text and draw(st.booleans()):
        for _ in range(draw(st.integers(1, 2))):
            text[draw(st.integers(0, len(text) - 1))] = draw(st.integers(0, 255))
    if draw(st.integers(0, 5)) == 0:
        del text[draw(st.integers(0, len(text))) :]
    return bytes(text)


@settings(max_examples=1000)
@given(text=texts(), chunk_bytes=st.sampled_from([1, 7, 64, 333, 1 << 16]))
def test_candump_in_chunks_gives_frames_counters_and_errors_of_the_streaming_reader(
    tmp_path_factory: pytest.TempPathFactory, text: bytes, chunk_bytes: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.log"
    path.write_bytes(text or b"\n")
    assert in_chunks(path, chunk_bytes) == streamed(path)


@settings(max_examples=100)
@given(text=texts(), cut=st.integers(1, 40), flipped=st.integers(0, 200), bit=st.integers(0, 7))
def test_damaged_gzip_gives_the_frames_before_and_the_error_of_the_streaming_reader(
    tmp_path_factory: pytest.TempPathFactory, text: bytes, cut: int, flipped: int, bit: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.log.gz"
    whole = bytearray(gzip.compress(text * 7))
    if flipped < len(whole):
        whole[flipped] ^= 1 << bit
    for kept in (whole, whole[:-cut]):
        path.write_bytes(kept or b"\0")
        assert in_chunks(path, 200) == streamed(path)
