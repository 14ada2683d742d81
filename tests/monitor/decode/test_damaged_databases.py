"""Damaged databases, maps and settings: a short form of ``benchmarks/fuzz_databases.py``."""

from pathlib import Path

from fuzz_databases import fuzz


def test_no_damaged_database_crashes_hangs_or_fills_the_memory(tmp_path: Path) -> None:
    lines: list[str] = []
    tally = fuzz(60, 21, tmp_path, lines.append)
    assert sum(tally.codes.values()) == 60
    assert not tally.complaints, lines
