"""The example in C beside ``o2mon run`` on one bus sends the same flags at the same samples."""

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from tests.conftest import ROOT
from tests.helpers.bus import on_can
from tests.vcan.guest import Finished

FROM_S, LENGTH_S = 8.0, 20.0  # the code is there after 10 s, later where the player lags
START_AND_END_S = 240.0  # boot, imports and shutdown, on one slow CPU that others use too


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
def test_the_example_sets_the_flag_at_the_sample_at_which_the_monitor_sets_it(
    run_with_vcan: Callable[..., Finished], tmp_path: Path
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
