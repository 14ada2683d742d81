"""``python -m benchmarks``: what cannot be used ends in one line."""

from pathlib import Path

import pytest

from benchmarks.__main__ import main


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("Time,RPM\n", "no row of column names"),
        ("time_s,lambda_measured\n0,1\n1,1\n", "tables need"),
    ],
)
def test_a_log_without_what_tables_need_ends_in_one_line_that_names_it(
    tmp_path: Path, text: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "drive.csv"
    log.write_text(text)
    assert main(["tables", "--logs", str(log)]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert told[0].startswith(f"tables: {log}: ")
    assert why in told[0]
