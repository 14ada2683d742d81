"""A SocketCAN interface that goes away under the monitor and comes back; polling on it."""

import json
import re
import sys
from collections.abc import Callable
from typing import Any

from tests.conftest import ROOT
from tests.vcan.guest import Finished

N_SENT = 60


def test_the_monitor_listens_again_after_its_interface_was_gone_and_an_ecu_is_polled_on_it(
    run_with_vcan: Callable[..., Finished],
) -> None:
    finished = run_with_vcan(
        [sys.executable, "-m", "tests.vcan.down_and_up"], ROOT, timeout_s=300.0
    )
    assert finished.returncode == 3, finished.stdout  # nothing was judged, but all was heard
    lines = finished.stdout.splitlines()
    notes = re.findall(r"^bus: (lost|back)", finished.stdout, re.MULTILINE)
    health: dict[str, Any] = json.loads([line for line in lines if '"kind": "health"' in line][-1])
    # THEN every frame sent while the interface was up came, before and after each loss
    wanted = {"frames": N_SENT, "losses": 2, "reconnects": 2, "detached": 0}
    wanted |= {"state": "active", "timestamps": "kernel"}
    assert health | wanted == health
    assert notes == ["lost", "back"] * 2
    assert health["receive_buffer_bytes"] > 1 << 20
    # AND an ECU there was polled meanwhile, with answers of several frames (ISO-TP)
    asked = re.search(r"OBD-II: (\d+) requests, (\d+) answered$", finished.stdout, re.MULTILINE)
    assert asked is not None, finished.stdout
    assert int(asked[1]) >= int(asked[2]) > 10
    assert re.search(r"lambda_measured .* 1\.013 .* plausible", finished.stdout)
    assert "the model has all its signals" in finished.stdout
