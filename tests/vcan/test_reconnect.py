"""A SocketCAN interface that goes away under the monitor and comes back."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.vcan.guest import Finished

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "tests" / "vcan" / "down_and_up.py"
N_SENT = 60


def test_the_monitor_listens_again_after_the_interface_was_down_and_after_it_was_gone(
    run_with_vcan: Callable[..., Finished],
) -> None:
    finished = run_with_vcan([sys.executable, str(SCRIPT)], ROOT, timeout_s=300.0)
    assert finished.returncode == 3, finished.stdout  # nothing was judged, but all was heard
    lines = [json.loads(line) for line in finished.stdout.splitlines() if line.startswith("{")]
    notes = [line["text"] for line in lines if line["type"] == "note"]
    health: dict[str, Any] = [line for line in lines if line["type"] == "health"][-1]
    # THEN every frame sent while the interface was up came, before and after each loss
    assert health["frames"] == N_SENT
    assert (health["losses"], health["reconnects"], health["state"]) == (2, 2, "active")
    assert [note.split(":")[1].split()[0] for note in notes] == ["lost", "back"] * 2
    assert health["timestamps"] == "kernel"
    assert health["receive_buffer_bytes"] > 1 << 20
    assert health["detached"] == 0
