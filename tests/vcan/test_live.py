"""The live page of a monitor on a real SocketCAN bus."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

from tests.vcan.guest import Finished
from tests.vcan.test_socketcan import PLAY, START_AND_END_S, recording_of, stretch, write_log

WATCH = Path(__file__).with_name("watch_page.py")
STRETCH_S = 44.0  # the code is set after 30, later on a busy machine
PORT = 8765


def test_the_page_shows_the_code_of_a_fault_on_the_bus(
    run_with_vcan: Callable[..., Finished], tmp_path: Path
) -> None:
    # GIVEN a drive with a late sensor, played into vcan0
    played, state = tmp_path / "played.log", tmp_path / "state.json"
    write_log(played, stretch(recording_of("delay_rich_to_lean"), 0.0, STRETCH_S))
    run = ["run", "-i", "socketcan", "-c", "vcan0", "--live", str(PORT)]
    limit = ["--duration", str(STRETCH_S + START_AND_END_S)]  # it is interrupted before
    monitor = [sys.executable, "-m", "monitor.cli", *run, *limit]
    watch = [sys.executable, str(WATCH), f"http://127.0.0.1:{PORT}/", str(state), *monitor]
    # WHEN a browser comes at its end
    finished = run_with_vcan(
        [sys.executable, str(PLAY), str(played), "--", *watch],
        tmp_path,
        timeout_s=STRETCH_S + START_AND_END_S,
    )
    assert finished.returncode in {0, 3}, finished.stdout
    # THEN it is shown the drive and its code
    seen = json.loads(state.read_text())
    assert seen["channel"] == "socketcan vcan0"
    assert len(seen["samples"]) > 0.8 * STRETCH_S * 10
    assert [code["code"] for code in seen["memory"]["codes"]] == ["P015A"]
    assert seen["health"]["frames"] > 0.8 * STRETCH_S * 190
    assert seen["health"]["timestamps"] == "kernel"
    assert seen["health"]["page_dropped"] == 0
