"""python-can as where asammdf is not installed."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
DRIVE = ROOT / "replay_logs" / "transient_micro_trips_v109_s113.blf"

SCRIPT = f"""
import sys
from monitor.cli import main
assert main(["replay", {str(DRIVE)!r}, "--quiet"]) in (0, 1)
assert "can" not in sys.modules
from monitor.frames.text.python_can import import_without_mdf
import_without_mdf()
assert "can" in sys.modules
assert not sys.modules.keys() & {{"asammdf", "pandas", "polars", "sympy", "numba", "training"}}
from asammdf import MDF
"""


def test_a_replay_imports_no_python_can_and_that_nothing_of_the_extras() -> None:
    assert subprocess.run([sys.executable, "-c", SCRIPT], check=False, cwd=ROOT).returncode == 0
