"""BLF at once: the frames, counters and errors of python-can's reader."""

import re
import struct
import zlib
from itertools import pairwise
from pathlib import Path

import can
import pytest
from can.util import dlc2len
from hypothesis import example, given
from hypothesis import strategies as st

from monitor.frames.blf import blocks as blf_blocks
from monitor.frames.blocks import LogCounters
from monitor.frames.logs import guarded
from tests.helpers.examples import inputs
from tests.helpers.logs.read_outcome import frames_of, outcome, python_can_reads, read_at_once


@pytest.mark.parametrize(
    ("announced", "error"), [(2, None), (3, None), (4, "its header announces 4 objects")]
)
def test_a_blf_must_hold_as_many_objects_as_announced_whatever_they_are(
    tmp_path: Path, announced: int, error: str | None
) -> None:
    path = tmp_path / "marked.blf"
    with can.BLFWriter(path) as writer:
        writer.on_message_received(can.Message(timestamp=1.7e9, arbitration_id=1, data=b"\1"))
        writer.log_event("a marker is an object", 1.7e9)
        writer.on_message_received(can.Message(timestamp=1.7e9, arbitration_id=1, data=b"\2"))
    content = bytearray(path.read_bytes())
    assert content[32:36] == struct.pack("<L", 3)
    content[32:36] = struct.pack("<L", announced)
    path.write_bytes(content)
    found = read_at_once(path)
    assert [frame.data for frame in found[0]] == [b"\1", b"\2"]
    assert found[2] is None
    assert (found[1].notes == []) if error is None else (error in found[1].notes[0])


VERSIONS = (5, 0, 0, 0, 2, 6, 8, 1)  # of the program and the library that wrote it
STORED, UNKNOWN, DEFLATED, CUT = range(4)  # ways of a container; the last is half of one


def blf_file(containers: list[tuple[bytes, int]], millisecond: int = 0) -> bytes:
    """Return a BLF file of containers, each with its way of compression."""
    content = b""
    for part, way in containers:
        packed = zlib.compress(part) if way in {DEFLATED, CUT} else part
        packed = packed[: len(packed) // 2] if way == CUT else packed
        size, method = 32 + len(packed), min(way, DEFLATED)
        content += struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, size, 10, method, len(part))
        content += packed + bytes(size % 4)
    start = (2026, 11, 6, 21, 9, 30, 5, millisecond)
    sizes = 144 + len(content), 0, 0, 0
    head = struct.pack("<4sL8BQQLL8H8H", b"LOGG", 144, *VERSIONS, *sizes, *start, *start)
    return head.ljust(144, b"\0") + content


# errors where python-can reads on: bytes of the next object, or to the end for one that is too long
OWN = re.compile("lie outside of its object|an object of .* bytes, at most")


def fd_object(n: int, data: bytes, *, header: int = 32, behind: int = 0) -> bytes:
    """Return a CAN FD object that announces n bytes of data.

    header, behind : length of its header and end of its data, as it says
    """
    code = next(code for code in range(16) if dlc2len(code) == n)
    body = struct.pack("<BBBBLLLLLLLHBBL", 1, code, n, 0, 7, 0, 0x1000, *[0] * 6, behind, 0)
    size = 72 + len(data)
    head = struct.pack("<4sHHLLLLQ", b"LOBJ", header, 1, size, 101, 2, 0, 10**9)
    return head + body + data + bytes(size % 4)


@pytest.mark.parametrize("cuts", [[], [90], [155], [160, 222]])
@pytest.mark.parametrize("wrong", [{"header": 20}, {"header": 105}, {"behind": 88}, {"behind": 60}])
def test_can_fd_data_outside_of_their_object_are_damage_however_the_file_is_cut(
    tmp_path: Path, wrong: dict[str, int], cuts: list[int]
) -> None:
    parts = [fd_object(8, b"abcdefgh"), fd_object(16, b"short", **wrong), fd_object(8, b"abcdefgh")]
    content = b"".join(parts)
    edges = pairwise([0, *cuts, len(content)])
    path = tmp_path / "over.blf"
    path.write_bytes(blf_file([(content[begin:end], DEFLATED) for begin, end in edges]))
    found = read_at_once(path)
    assert [frame.data for frame in found[0]] == [b"abcdefgh"]
    error = "the data of a frame of 16 bytes lie outside of its object"
    assert found[2] == f"{path}: damaged or cut short after 1 frames: {error}"


WORD = st.integers(0, 2**32 - 1)
TICKS = st.one_of(st.integers(0, 10**13), st.integers(0, 2**64 - 1), st.just(0))


@st.composite
def objects(draw: st.DrawFn) -> bytes:
    """Draw an object of a BLF's inside, mostly as it should be."""
    kind = draw(st.sampled_from([1, 1, 86, 73, 100, 101, 96, 115]))
    can_id = draw(WORD)
    code = draw(st.integers(0, 8)) if draw(st.integers(0, 9)) else draw(st.integers(0, 255))
    flags = draw(st.sampled_from([0, 0, 0, 1, 0x80, 0x10]))
    payload = draw(st.binary(min_size=64, max_size=64))
    if kind in (1, 86):
        body = struct.pack("<HBBL8s", 1, flags, code, can_id, payload)
    elif kind == 100:
        code = draw(st.integers(0, 15)) if code <= 8 else code
        n = dlc2len(code) if draw(st.integers(0, 9)) else draw(st.integers(0, 255))
        body = struct.pack("<HBBLLBBB5x64s", 1, flags, code, can_id, 0, 0, 1, n, payload)
    elif kind == 101:
        code = draw(st.integers(0, 15)) if code <= 8 else code
        n = dlc2len(code) if draw(st.integers(0, 9)) else draw(st.integers(0, 255))
        data = payload[: draw(st.sampled_from([n, n, 0, 3]))]
        end = 72 + len(data)
        behind = draw(st.sampled_from([0, 0, end, max(end - 2, 72), end + 9]))  # where data ends
        body = struct.pack(
            "<BBBBLLLLLLLHBBL", 1, code, n, 0, can_id, 0, flags, 0, 0, 0, 0, 0, 0, behind, 0
        )
        body += data
    else:
        body = payload[: draw(st.integers(0, 64))]
    version = draw(st.sampled_from([1, 1, 1, 1, 2, 3]))
    head = struct.pack("<LBxHQ", draw(st.integers(0, 3)), 0, 0, draw(TICKS))
    head += bytes(8) if version == 2 else b""
    size = 16 + len(head) + len(body)
    n_header = 16 + len(head) - draw(st.sampled_from([0] * 18 + [1, -2]))
    base = struct.pack("<4sHHLL", b"LOBJ", n_header, version, size, kind)
    padding = size % 4 if draw(st.booleans()) else -size % 4
    return base + head + body + bytes(padding)


@st.composite
def blf_files(draw: st.DrawFn) -> bytes:
    """Draw a BLF file whose objects cross its containers, sometimes spoilt."""
    found = draw(st.lists(st.one_of(objects(), st.just(b"")), max_size=20))
    content = bytearray(b"".join(found) * draw(st.sampled_from([1, 1, 3])))
    if content and draw(st.integers(0, 3)) == 0:
        content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
    cuts = sorted(draw(st.lists(st.integers(0, len(content)), max_size=4)))
    ways = st.sampled_from([DEFLATED] * 9 + [STORED] * 4 + [UNKNOWN, CUT])
    containers = [
        (bytes(content[begin:end]), draw(ways)) for begin, end in pairwise([0, *cuts, len(content)])
    ]
    return blf_file(containers, draw(st.integers(0, 999)))


# objects with 5 of 16 bytes, and with an extension behind 3 of 8 bytes: the rest is zeros
SHORT = fd_object(16, b"short") + fd_object(8, b"12345678", behind=75) + fd_object(8, b"abcdefgh")


@inputs(150)
@example(content=blf_file([(SHORT, DEFLATED)]), chunk_bytes=1 << 20)
@example(content=blf_file([(SHORT[:148], DEFLATED), (SHORT[148:], DEFLATED)]), chunk_bytes=1)
@given(content=blf_files(), chunk_bytes=st.sampled_from([1, 1, 200, 1 << 20]))
def test_blf_objects_of_every_kind_are_read_as_python_can_reads_them(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, chunk_bytes: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.blf"
    path.write_bytes(content)
    counters = LogCounters()
    with path.open("rb") as file:
        blocks = guarded(
            path, counters, blf_blocks.read_blocks(file, counters, chunk_bytes=chunk_bytes)
        )
        found = outcome((frame for block in blocks for frame in frames_of(block)), counters)
    if "an object has no length" in str(found[2]):
        return  # python-can reads it for ever
    wanted = python_can_reads(path)
    if found[2] and OWN.search(found[2]):
        n = len(found[0])
        assert found[0] == wanted[0][:n]
        assert found[1].frames == n
        assert f"after {n} frames" in found[2] or not n
        return
    assert found[0] == wanted[0]
    assert (found[1].frames, found[1].skipped) == (wanted[1].frames, wanted[1].skipped)
    # AND frames of an unknown version, which python-can leaves out, are told
    known = re.sub(r"; \d+ objects of header version \d+ are not read", "", found[2] or "")
    assert known == (wanted[2] or "")
