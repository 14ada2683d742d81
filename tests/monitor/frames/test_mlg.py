"""MLG logs: both versions, every type of field, markers, damage, cuts, and the clock's wraps."""

from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.frames.tables.mlg import TIMESTAMP, open_mlg
from monitor.frames.tables.mlg_blocks import CHUNK
from monitor.frames.tables.raw_table import Notes
from tests.helpers.logs.logger_files import (
    CODES,
    Field,
    cells_of,
    mlg_blocks,
    mlg_header,
    mlg_marker,
    write_mlg,
)

FIELDS = [Field(f"x {dtype}", "u", dtype, 0.5, 2.0) for dtype in CODES]


def numbers(n: int = 50) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.integers(2, 50, (n, len(FIELDS))).astype(float)


@pytest.mark.parametrize("version", [1, 2])
def test_every_type_of_field_is_read_with_scale_and_transform(tmp_path: Path, version: int) -> None:
    values, t_s = numbers(), 0.1 * np.arange(50)
    path = write_mlg(tmp_path / "a.mlg", FIELDS, values, t_s, version=version, info='"rusEFI"')
    raw = open_mlg(path)
    assert raw.names == (*(field.name for field in FIELDS), TIMESTAMP)
    assert {column.unit for column in raw.columns} == {"u", "s"}
    assert raw.preamble == '"rusEFI"'
    found, notes = cells_of(raw)
    np.testing.assert_allclose(found[:, :-1], values)
    # the timestamps wrap after 0.66 s and are read on
    np.testing.assert_allclose(found[:, -1], t_s, atol=1e-5)
    assert notes == Notes()


@pytest.mark.parametrize("chunk", [100, 230, CHUNK])
def test_markers_are_counted_and_records_with_a_wrong_checksum_left_out(
    chunk: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monitor.frames.tables.mlg_blocks.CHUNK", chunk)
    values, t_s = numbers(20), 0.1 * np.arange(20)
    blocks = mlg_blocks(FIELDS, values, t_s)
    blocks[7] = blocks[7][:9] + bytes([blocks[7][9] ^ 4]) + blocks[7][10:]
    blocks.insert(12, mlg_marker("too rich here", 1.2))
    path = tmp_path / "a.mlg"
    path.write_bytes(mlg_header(2, FIELDS) + b"".join(blocks))
    found, notes = cells_of(open_mlg(path))
    np.testing.assert_allclose(found[:, :-1], np.delete(values, 7, axis=0))
    np.testing.assert_allclose(found[:, -1], np.delete(t_s, 7), atol=1e-5)
    assert notes.counts == {"bad_checksum": 1, "markers": 1}


def test_bytes_that_got_lost_cost_one_record(tmp_path: Path) -> None:
    values, t_s = numbers(40), 0.1 * np.arange(40)
    blocks = mlg_blocks(FIELDS, values, t_s)
    blocks[10] = blocks[10][:6] + blocks[10][9:]
    path = tmp_path / "a.mlg"
    path.write_bytes(mlg_header(1, FIELDS) + b"".join(blocks))
    found, notes = cells_of(open_mlg(path))
    np.testing.assert_allclose(found[:, :-1], np.delete(values, 10, axis=0))
    assert notes.counts == {"damaged_bytes": len(blocks[10])}


def test_a_log_cut_in_the_middle_is_read_to_the_cut_and_says_so(tmp_path: Path) -> None:
    path = write_mlg(tmp_path / "a.mlg", FIELDS, numbers(30), 0.1 * np.arange(30))
    path.write_bytes(path.read_bytes()[:-10])
    found, notes = cells_of(open_mlg(path))
    assert len(found) == 29
    assert notes.lines[0].startswith("cut short after 29 records")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:10], "ends within its header"),
        (lambda b: b"MLVLX\0" + b[6:], "begins with"),
        (lambda b: b[:7] + b"\x09" + b[8:], "version 9, versions 1 and 2"),
        (lambda b: b[:24] + b"\x2a" + b[25:], "field 1: type 42"),
        (lambda b: b[:20] + b"\x00\x01" + b[22:], "records of 1 bytes, its 8 fields take 26"),
        (lambda b: b[:22] + b"\xff\xff" + b[24:], "fields"),
    ],
)
def test_a_damaged_header_is_one_line(tmp_path: Path, change: object, message: str) -> None:
    path = write_mlg(tmp_path / "a.mlg", FIELDS, numbers(3), 0.1 * np.arange(3))
    path.write_bytes(change(path.read_bytes()))  # type: ignore[operator]
    with pytest.raises(RecordingError, match=message) as caught:
        open_mlg(path)
    assert str(path) in str(caught.value)


def test_real_logs_of_rusefi_and_speeduino_are_read(shared_data: Path) -> None:
    folder = shared_data / "logs" / "rusefi_speeduino"
    for name, n_fields, n_records in (("rusefi_log1", 782, 727), ("speeduino", 59, 139)):
        raw = open_mlg(folder / f"{name}.mlg")
        found, notes = cells_of(raw)
        assert found.shape == (n_records, n_fields + 1)
        assert not notes.lines
        times = found[:, [raw.names.index("Time"), n_fields]]
        steps_s = np.diff(times, axis=0)[1:]
        np.testing.assert_allclose(steps_s[:, 0], steps_s[:, 1], atol=0.03)
