"""Logs that no logger writes: they end in one error line, with little memory and at once."""

import gzip
import os
import random
import re
import socket
import struct
from pathlib import Path

import pytest

from monitor.base.errors import RecordingError
from monitor.frames.blocks import LogCounters
from monitor.frames.bounds import FREE_BYTES, LINE_BYTES, PIECE_BYTES, RATIO
from monitor.frames.logs import read_frames
from tests.helpers.logs.read_outcome import read_at_once, streamed, synthetic
from tests.monitor.frames.test_blf_blocks import DEFLATED, STORED, blf_file, fd_object
from training.recordings.files.mf4_log import write_mf4

FRAME = {
    ".log": "(1.000000) vcan0 123#0102\n",
    ".asc": "no internal events logged\n   1.000000 1  123             Rx   d 2 01 02\n",
    ".csv": "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.0,0x123,0,0,0,2,AQI=\n",
    ".trc": ";$FILEVERSION=1.1\n     1)      1.0  Rx     0123  2  01 02\n",
}
# wide enough for the identifier of the test to take its place
WIDE = {
    ".log": ("123#", "{}#"),
    ".asc": ("123             Rx", "{}x Rx"),
    ".csv": ("0x123", "0x{}"),
    ".trc": ("0123", "{}"),
}


def refused(path: Path, message: str) -> None:
    """The log is refused; candump line by line with the same words after the same frames."""
    found = read_at_once(path)
    error = found[2]
    assert error is not None
    assert str(path) in error
    assert message in error
    assert "\n" not in error
    if ".log" in path.suffixes:
        assert found == streamed(path)


@pytest.mark.parametrize("packed", ["", ".gz"])
@pytest.mark.parametrize("kind", FRAME)
def test_a_line_that_never_ends_ends_the_log(tmp_path: Path, kind: str, packed: str) -> None:
    path = tmp_path / f"drive{kind}{packed}"
    text = (FRAME[kind] + random.Random(1).randbytes(LINE_BYTES).hex()).encode()
    path.write_bytes(gzip.compress(text, 1) if packed else text)
    refused(path, f"after 1 frames: a line of {LINE_BYTES:,} bytes or more")


def test_a_line_just_below_the_bound_is_left_out_and_told_by_both_readers(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text(FRAME[".log"] + "0" * (LINE_BYTES - 1) + "\n" + FRAME[".log"])
    assert read_at_once(path) == streamed(path)
    assert "line 2 is" in read_at_once(path)[1].notes[0]


@pytest.mark.parametrize("kind", [".log", ".asc", ".csv", ".trc", ".blf", ".mf4"])
def test_a_packed_log_that_grows_without_end_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"drive{kind}.gz"
    once = FRAME.get(kind, "")
    *head, frame = once.splitlines(keepends=True) if once else ("", "\0")
    again = frame if kind == ".csv" else " " * 99 + "\n" if once else "\0"
    text = "".join([*head, again * (2 * FREE_BYTES // len(again))])
    path.write_bytes(gzip.compress(text.encode(), 9))
    refused(path, f"at most {RATIO} times as many are wanted" if once else "damaged")


OBJECT, HALF = struct.Struct("<4sHHLL"), FREE_BYTES // 2
BLF = {  # containers behind that of a sound frame
    "a packed piece of more than": [(bytes(PIECE_BYTES + 1), DEFLATED)],
    f"at most {RATIO} times as many are wanted": 6
    * [(OBJECT.pack(b"LOBJ", 32, 1, HALF, 200).ljust(HALF, b"\0"), DEFLATED)],
    "an object of 2,147,483,648 bytes": [
        (OBJECT.pack(b"LOBJ", 32, 1, 1 << 31, 1) + bytes(5000), STORED)
    ],
}


@pytest.mark.parametrize("message", BLF)
def test_a_blf_or_an_object_of_it_without_end_is_refused(tmp_path: Path, message: str) -> None:
    path = tmp_path / "drive.blf"
    path.write_bytes(blf_file([(fd_object(8, b"abcdefgh"), DEFLATED), *BLF[message]]))
    refused(path, message)
    assert len(read_at_once(path)[0]) == 1


@pytest.mark.parametrize("kind", [".log", ".asc.gz", ".blf", ".mf4", ".csv"])
def test_a_fifo_a_socket_and_a_device_are_refused_at_once(tmp_path: Path, kind: str) -> None:
    fifo, device, port = (tmp_path / f"{name}{kind}" for name in ("fifo", "device", "port"))
    os.mkfifo(fifo)
    device.symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(str(port))
        for path, word in ((fifo, "a FIFO"), (device, "a device"), (port, "a socket")):
            with pytest.raises(RecordingError, match=f"is {word}, a regular file is wanted"):
                read_at_once(path)


@pytest.mark.parametrize("kind", [".asc", ".csv", ".trc"])
@pytest.mark.parametrize("identifier", ["20000000", "1FFFFFFFF", "FFFFFFFFFFFFFFFFFFFF"])
def test_a_line_whose_identifier_has_more_than_29_bits_is_left_out_and_told(
    tmp_path: Path, kind: str, identifier: str
) -> None:
    path = tmp_path / f"drive{kind}"
    before, after = WIDE[kind]
    line = FRAME[kind].splitlines(keepends=True)[-1]
    path.write_text(FRAME[kind] + line.replace(before, after.format(identifier)))
    counters = LogCounters()
    assert (len(list(read_frames(path, counters))), counters.damaged) == (1, 1)


@pytest.fixture
def mf4(tmp_path: Path) -> Path:
    """A sound MF4 of nine frames."""
    path = tmp_path / "drive.mf4"
    write_mf4(path, synthetic(9))
    return path


def test_an_mf4_whose_channel_lies_beyond_its_record_is_refused(mf4: Path) -> None:
    whole = bytearray(mf4.read_bytes())
    links, fields = 24 + 8 * 8, struct.Struct("<BBBBII")  # kinds, bit offset, byte offset, bits
    for found in re.finditer(b"##CN", bytes(whole)):
        place = found.start() + links
        kind, sync, data, bit, _, n_bits = fields.unpack_from(whole, place)
        fields.pack_into(whole, place, kind, sync, data, bit, 1 << 20, n_bits)
    mf4.write_bytes(whole)
    refused(mf4, "lies beyond its record")


def test_an_mf4_that_announces_more_records_than_it_holds_is_refused(mf4: Path) -> None:
    whole = bytearray(mf4.read_bytes())
    group = whole.index(b"##CG") + 24 + 6 * 8
    struct.pack_into("<I", whole, group + 24, 1 << 31)  # bytes of a record
    mf4.write_bytes(whole)
    refused(mf4, "bytes of the file grow to more than")
