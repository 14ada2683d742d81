"""A short run of what the benchmark ``soak`` does at length."""

import json
from pathlib import Path

import pytest

from benchmarks.__main__ import main


def test_memory_is_flat_while_the_loop_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monitor.bus.judging.KEEP", 3)  # windows, soon reached
    monkeypatch.setattr("monitor.judge.causes.observation._BATCH", 8)  # samples, else 2048
    out = tmp_path / "soak.json"
    assert main(["soak", "--hours", "0.041", "--every", "0.01", "--json", str(out)]) == 0  # no code
    *points, _ = json.loads(out.read_text())["rows"]
    assert points[-1]["windows"] > 2 * 3
    # behind the stretch that fills what is kept, not two objects or 100 bytes a second may stay
    stretch_s = 3600 * (points[-1]["bus_h"] - points[2]["bus_h"])
    assert points[-1]["objects"] - points[2]["objects"] < 2 * stretch_s
    assert points[-1]["buffers_kb"] - points[2]["buffers_kb"] < 0.1 * stretch_s
