"""Fuzzers of benchmarks/ in a process of their own: they replace parts of the program."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def complaints(script: str, keep: Path, *options: str) -> list[str]:
    """Return the lines of broken promises, but for codes that the content of a log explains."""
    command = [sys.executable, f"benchmarks/{script}", *options, "--keep", str(keep)]
    ran = subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, timeout=300, check=False
    )
    assert "calls (" in ran.stdout, ran.stderr
    kept = (line for line in ran.stdout.splitlines() if str(keep) in line or "Outcome(" in line)
    return [line for line in kept if not line.startswith("false code:")]
