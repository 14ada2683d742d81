"""Damaged logs and tables of every format: a short form of ``benchmarks/fuzz_logs.py``."""

from pathlib import Path

from fuzz_logs import fuzz


def test_no_damaged_log_crashes_hangs_or_fills_the_memory(tmp_path: Path) -> None:
    lines: list[str] = []
    tallies = fuzz(150, 10, tmp_path, lines.append)
    assert sum(sum(tally.codes.values()) for tally in tallies.values()) == 150
    found = {name for tally in tallies.values() for name in tally.complaints}
    assert found <= {"false code"}, lines
