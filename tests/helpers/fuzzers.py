"""Fuzzers of benchmarks/ in a process of their own: they replace parts of the program."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def complaints(name: str, keep: Path, *options: str) -> list[str]:
    """Return the lines of broken promises."""
    command = [sys.executable, "-m", "benchmarks", name, *options, "--keep", str(keep)]
    ran = subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, timeout=300, check=False
    )
    assert "calls" in ran.stdout, ran.stderr
    return [line for line in ran.stderr.splitlines() if "Outcome(" in line]
