"""Damaged logs and tables of every format: a short form of the benchmark ``fuzz_logs``."""

from pathlib import Path

from tests.helpers.fuzzers import complaints


def test_no_damaged_log_crashes_hangs_or_fills_the_memory(tmp_path: Path) -> None:
    assert complaints("fuzz_logs", tmp_path, "--cases", "150", "--seed", "10") == []
