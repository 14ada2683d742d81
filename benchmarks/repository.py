"""The repository's root and its commit."""

import subprocess
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
REPLAY_LOGS: Final = ROOT / "replay_logs"


def commit() -> str:
    """Return the short hash of the commit, with "+" behind it if files differ from it."""

    def git(*words: str) -> str:
        ran = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        return ran.stdout.strip()

    head = git("rev-parse", "--short=8", "HEAD")
    return (head or "unknown") + ("+" if git("status", "--porcelain", "-uno") else "")
