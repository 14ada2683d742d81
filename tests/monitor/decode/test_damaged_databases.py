"""Damaged databases, maps and settings: a short form of the benchmark ``fuzz_databases``."""

from pathlib import Path

from tests.helpers.fuzzers import complaints


def test_no_damaged_database_crashes_hangs_or_fills_the_memory(tmp_path: Path) -> None:
    assert complaints("fuzz_databases", tmp_path, "--cases", "60", "--seed", "21") == []
