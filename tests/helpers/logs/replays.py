"""The recordings of replay_logs, and ``o2mon replay`` as the tests of several rooms call it."""

import json
import tempfile
from math import inf
from pathlib import Path
from typing import Any

from monitor import cli
from monitor.base.types import Frame
from monitor.frames.logs import read_frames
from tests.conftest import ROOT


def replay_log(begin: str) -> Path:
    """Return the first of the replay logs whose name begins so."""
    return min((ROOT / "replay_logs").glob(f"{begin}*.blf"))


def frames_of(begin: str, seconds: float = inf) -> list[Frame]:
    """Return the frames of a replay log, the first so many seconds."""
    frames = list(read_frames(replay_log(begin)))
    return [frame for frame in frames if frame.t_ns < frames[0].t_ns + seconds * 1e9]


def replays(*words: str | Path) -> tuple[int, list[dict[str, Any]]]:
    """Return the exit code of a replay and what its JSON says of each recording."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        code = cli.main(["replay", *map(str, words), "--json", str(out)])
        found: list[dict[str, Any]] = json.loads(out.read_text())["recordings"]
    return code, found
