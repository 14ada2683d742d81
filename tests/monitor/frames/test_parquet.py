"""Parquet tables through polars."""

import os
from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.frames.tables import parquet

polars = pytest.importorskip("polars")


def written(path: Path) -> Path:
    """Write columns of each kind: whole numbers, floats with a gap, flags, a text."""
    polars.DataFrame(
        {
            "time_s": [0.0, 0.1, 0.2],
            "engine_speed_rpm": [800, 900, 1000],
            "lambda_measured": [1.0, None, 1.02],
            "closed_loop": [True, False, None],
            "remark": ["a", "b", "c"],
        }
    ).write_parquet(path)
    return path


def test_numbers_flags_and_gaps_are_read(tmp_path: Path) -> None:
    path = written(tmp_path / "drive.parquet")
    names, cells = parquet.read_parquet(path, {"time_s"})
    assert names == ["time_s", "engine_speed_rpm", "lambda_measured", "closed_loop"]
    wanted = [[0.0, 800.0, 1.0, 1.0], [0.1, 900.0, np.nan, 0.0], [0.2, 1000.0, 1.02, np.nan]]
    np.testing.assert_array_equal(cells, wanted)
    with pytest.raises(RecordingError, match="column remark holds no numbers"):
        parquet.read_parquet(path, None)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(RecordingError, match="cannot read the table"):
        parquet.read_parquet(path, None)


def test_a_panic_of_polars_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a damaged table on which polars panics, which is no Exception

    def panics(_: object) -> None:
        os.write(2, b"thread '<unnamed>' panicked\n")  # as compiled code does
        raise polars.exceptions.PanicException("assertion failed")

    path = written(tmp_path / "t.parquet")
    monkeypatch.setattr(polars, "read_parquet", panics)
    with pytest.raises(RecordingError, match=r"t\.parquet: cannot read the table: damaged"):
        parquet.read_parquet(path, None)
    assert capfd.readouterr().err == ""
