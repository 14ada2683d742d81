"""The bus of the kernel: the example in C, a container, an interface that goes and comes back."""

import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from tests.conftest import ROOT
from tests.helpers.bus import on_can
from tests.vcan import guest

FROM_S, LENGTH_S = 8.0, 20.0  # the code is there after 10 s, later where the player lags
START_AND_END_S = 240.0  # boot, imports and shutdown, on one slow CPU that others use too


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_the_example_sets_the_flag_at_the_sample_at_which_the_monitor_sets_it(
    run_with_vcan: Callable[..., guest.Finished], tmp_path: Path
) -> None:
    # GIVEN a part of a faulty drive, and the example built for this machine
    log, program = tmp_path / "played.log", on_can.compiled_in(tmp_path / "o2c")
    (drive,) = (ROOT / "replay_logs").glob("out_of_range_*")
    with can.LogReader(drive) as reader, can.CanutilsLogWriter(log) as writer:
        frames = list(reader)
        for frame in frames:
            frame.channel = "vcan0"
            if FROM_S <= frame.timestamp - frames[0].timestamp < FROM_S + LENGTH_S:
                writer.on_message_received(frame)
    # WHEN it is played into vcan0, where both listen
    out = tmp_path / "sent.json"
    command = [sys.executable, str(ROOT / "tests" / "vcan" / "two_monitors.py"), log, program, out]
    finished = run_with_vcan(command, ROOT, timeout_s=LENGTH_S + START_AND_END_S, n_buses=2)
    assert finished.returncode == 0, finished.stdout
    by_python, in_c = (list(map(bytes.fromhex, p)) for p in json.loads(out.read_text()).values())
    # THEN the kernel stamps a frame once for all sockets, so both have the same samples: the flag
    # is set at the same one, and every status before and after it says the same
    flagged = on_can.first_flag(by_python)
    assert flagged is not None
    assert on_can.first_flag(in_c) == flagged
    said = [[on_can.without_share(payload) for payload in each] for each in (by_python, in_c)]
    n = min(map(len, said))  # one may have told a tick more when the drive ended
    assert n > flagged
    assert said[1][:n] == said[0][:n]


BUS = "from examples.virtual_bus import bus; print(*bus('vcan0'), sep='')"
CONTAINER = """
inside() { # COMMANDS RIGHT WORDS: of Python, after commands in the new network
  unshare --net --mount sh -c "mount -t sysfs sys /sys; ip link set lo up; $1
    setpriv --bounding-set $2 '$python' $3"
}
inside : +net_admin "-c \\"$bus\\""
inside : -net_admin "-c \\"$bus\\""
inside 'ip route add multicast 239.0.0.0/8 dev lo' -net_admin "-c \\"$bus\\""
inside : -net_admin "-m monitor.cli check -i udp_multicast -c 239.74.163.2"
"""


def test_a_container_gets_its_bus_by_its_rights_and_its_network_or_is_told_what_lacks(
    run_with_vcan: Callable[..., guest.Finished],
) -> None:
    if guest.find_place() == "host":
        pytest.skip("this user may not make networks")
    shell = ["env", f"python={sys.executable}", f"bus={BUS}", "sh", "-c", CONTAINER]
    said = run_with_vcan(shell, ROOT, timeout_s=120.0).stdout
    made, refused, shared, checked = said.splitlines()
    lacks = "no vcan0: the right is missing (a container has it with --cap-add NET_ADMIN)"
    assert made == "socketcanvcan0"
    assert refused.startswith(f"no bus     {lacks}; no udp_multicast: ")
    assert shared == f"udp_multicast239.74.163.2 ({lacks})"
    assert checked.endswith("it needs a network, and here is none (a container's --network none?)")


N_SENT = 60


def test_the_monitor_listens_again_after_its_interface_was_gone_and_an_ecu_is_polled_on_it(
    run_with_vcan: Callable[..., guest.Finished],
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
