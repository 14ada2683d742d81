"""A bench on two virtual buses: player, gateway with a scenario, monitor, testers, browser."""

import json
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from obd import decoders

import dbc
from monitor.base.types import Frame
from monitor.decode.bus_map import load_pairs
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log
from monitor.inject.rewrite import writers
from tests.conftest import ROOT
from tests.helpers.logs.replays import replays
from tests.vcan.guest import Finished

BENCH = ROOT / "tests" / "vcan" / "bench.py"
HEALTHY = ROOT / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
FROM_S, LENGTH_S = 30.0, 38.0  # the code is there after 20 s, later on a busy machine
THINNED = (0xC0, 0xC1, 0xC2)  # from 50 to 25 frames/s each, so that both buses carry 250
PASSED = (0xC0, 0xC1, 0xC8, 0x1A0, 0x2A0, 0x2A1)  # of the ECU, without lambda
START_AND_END_S = 240.0  # boot, imports and shutdown, on one slow CPU that others use too

SCENARIO = """
title = "a sensor that is late from rich to lean"
[[fault]]
name = "delay_rich_to_lean"
severity = 0.8
start_s = 5.0
[[expect]]
code = "P015A"
state = "pending"
within_s = 75.0
"""


def test_a_fault_put_in_between_two_buses_is_found_and_told_to_testers_and_browser(
    run_with_vcan: Callable[..., Finished], tmp_path: Path
) -> None:
    # GIVEN a stretch of a healthy drive, and a scenario that makes the sensor late
    log, scenario = tmp_path / "played.log", tmp_path / "late.toml"
    write_log(log, thinned(stretch(list(read_frames(HEALTHY)))))
    scenario.write_text(SCENARIO)
    # WHEN it is played into vcan0, passed on to vcan1 by the gateway, and judged there
    command = [sys.executable, str(BENCH), str(log), str(scenario), str(tmp_path), str(LENGTH_S)]
    finished = run_with_vcan(command, ROOT, timeout_s=LENGTH_S + START_AND_END_S, n_buses=2)
    assert finished.returncode == 0, finished.stdout
    assert json.loads(finished.stdout.splitlines()[-1]) == {"player": 0, "gateway": 0, "monitor": 0}
    # THEN the monitor on vcan1 has the code and no other, and so has the gateway's own judge
    (live,) = json.loads((tmp_path / "run.json").read_text())["recordings"]
    codes = [(dtc["code"], dtc["fault"], dtc["state"]) for dtc in live["dtcs"]]
    assert codes == [("P015A", "delay_rich_to_lean", "pending")]
    table = (tmp_path / "inject.txt").read_text()
    assert "P015A pending within 75 s  P015A pending (delay_rich_to_lean) after" in table
    assert " 0 not sent, 0 error frames" in table
    # AND no frame was lost, and what was recorded replays to exactly what the monitor said
    recorded = tmp_path / "recorded.log"
    assert untouched(recorded) == untouched(log)
    _, (again,) = replays(recorded)
    assert live["windows"], "nothing was judged, so nothing was compared"
    assert live["windows"] == again["windows"]
    assert live["dtcs"] == again["dtcs"]
    # AND a UDS tester, an OBD tester behind the gateway, and the live page say the same
    told = json.loads((tmp_path / "clients.json").read_text())
    assert [(code[:4], status & 0x0F) for code, status in told["uds"].items()] == [("015A", 0x07)]
    answer = bytes.fromhex(told["obd"])
    assert answer[:2] == b"\x47\x01"
    assert str(decoders.parse_dtc((answer[2], answer[3]))[0]).upper() == "P015A"
    assert "<title>" in told["page"]
    shown = json.loads(told["event"].partition("data: ")[2])
    assert [code["code"] for code in shown["memory"]["codes"]] == ["P015A"]
    assert shown["channel"] == "socketcan vcan1"
    assert shown["health"]["timestamps"] == "kernel"
    assert len(shown["samples"]) > 150


def untouched(log: Path) -> list[tuple[int, bytes]]:
    """Return what the frames of the ECU say that the gateway only passes on, in order."""
    return [(f.can_id, f.data) for f in read_frames(log) if f.can_id in PASSED]


def stretch(frames: list[Frame]) -> list[Frame]:
    first_ns = frames[0].t_ns + round(FROM_S * 1e9)
    return [f for f in frames if 0 <= f.t_ns - first_ns < LENGTH_S * 1e9]


def thinned(frames: list[Frame]) -> list[Frame]:
    """Leave out every second frame of the fast messages; their counters count on."""
    by_key = writers(load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))]).channels)
    seen, kept = Counter[int](), []
    for frame in frames:
        seen[frame.can_id] += 1
        left_out, is_odd = divmod(seen[frame.can_id], 2)
        if frame.can_id not in THINNED:
            kept.append(frame)
        elif not is_odd:
            data = by_key[frame.can_id, False].write(frame.data, {}, -left_out)
            kept.append(frame._replace(data=data))
    return kept
