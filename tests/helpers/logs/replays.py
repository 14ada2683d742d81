"""``o2mon replay`` as the tests of several rooms call it."""

import json
import tempfile
from pathlib import Path
from typing import Any

from monitor import cli


def replays(*words: str | Path) -> tuple[int, list[dict[str, Any]]]:
    """Return the exit code of a replay and what its JSON says of each recording."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        code = cli.main(["replay", *map(str, words), "--json", str(out)])
        found: list[dict[str, Any]] = json.loads(out.read_text())["recordings"]
    return code, found
