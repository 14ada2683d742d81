"""Parquet tables through either library."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.frames.tables import parquet


def without(monkeypatch: pytest.MonkeyPatch, *hidden: str) -> None:
    """Hide libraries from the reader."""
    real = importlib.util.find_spec
    monkeypatch.setattr(parquet, "find_spec", lambda name: None if name in hidden else real(name))


def written(path: Path) -> Path:
    """Write columns of each kind: whole numbers, floats with a gap, flags, a text."""
    polars = pytest.importorskip("polars")
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


@pytest.mark.parametrize("library", ["polars", "pyarrow"])
def test_numbers_flags_and_gaps_are_read_through_either_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    path = written(tmp_path / "drive.parquet")
    pytest.importorskip(library)
    without(monkeypatch, *{"polars", "pyarrow"} - {library})
    names, cells = parquet.read_parquet(path, {"time_s"})
    assert names == ["time_s", "engine_speed_rpm", "lambda_measured", "closed_loop"]
    wanted = [[0.0, 800.0, 1.0, 1.0], [0.1, 900.0, np.nan, 0.0], [0.2, 1000.0, 1.02, np.nan]]
    np.testing.assert_array_equal(cells, wanted)
    with pytest.raises(RecordingError, match="column remark holds no numbers"):
        parquet.read_parquet(path, None)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(RecordingError, match="cannot read the table"):
        parquet.read_parquet(path, None)


def test_the_branch_for_pyarrow_takes_its_tables(tmp_path: Path) -> None:
    # GIVEN a library that reads as pyarrow does, where it is not installed
    class Column(list[object]):
        def to_pylist(self) -> list[object]:
            return list(self)

    class Library:
        @staticmethod
        def read_table(file: object) -> object:
            del file
            fields = [type("F", (), {"name": n, "type": t}) for n, t in KINDS]
            columns = [Column([1, None]), Column([0.5, None]), Column([True, None]), Column(["x"])]
            return type("T", (), {"schema": fields, "columns": columns})

    got = parquet._through_pyarrow(Library, None)  # type: ignore[arg-type]
    assert got["text"] is None
    for name, first in (("whole", 1.0), ("number", 0.5), ("flag", 1.0)):
        np.testing.assert_array_equal(got[name], [first, np.nan])


KINDS = (("whole", "int64"), ("number", "double"), ("flag", "bool"), ("text", "string"))


def test_a_panic_of_polars_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # GIVEN a damaged table on which polars panics, which is no Exception
    polars = pytest.importorskip("polars")

    def panics(_: object) -> None:
        raise polars.exceptions.PanicException("assertion failed")

    path = written(tmp_path / "t.parquet")
    monkeypatch.setattr(polars, "read_parquet", panics)
    with pytest.raises(RecordingError, match=r"t\.parquet: cannot read the table: damaged"):
        parquet.read_parquet(path, None)
