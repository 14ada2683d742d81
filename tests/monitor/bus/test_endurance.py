"""A short run of what the benchmark ``soak`` does at length."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main

EVERY_H = 0.005


def test_memory_stays_flat_in_the_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monitor.bus.judging.KEEP", 3)  # windows, soon reached
    monkeypatch.setattr("monitor.judge.causes.observation._BATCH", 8)  # samples, else 2048
    out = tmp_path / "soak.json"
    assert main(["soak", "--hours", "0.041", "--every", str(EVERY_H), "--json", str(out)]) == 0
    *points, _ = json.loads(out.read_text())["rows"]
    assert points[-1]["windows"] > 2 * 3
    # behind the stretch that fills what is kept, not two objects or 100 bytes a second may stay;
    # what grows, grows in most stretches, what another thread of this process takes in one
    held = np.array([[point["objects"], point["buffers_kb"]] for point in points[4:]])
    objects, buffers_kb = np.median(np.diff(held, axis=0), axis=0) / (3600 * EVERY_H)
    assert objects < 2.0
    assert buffers_kb < 0.1
