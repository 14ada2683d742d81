"""A run that is ended from outside still says and writes what it found."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from monitor.bus.ending import ended_by_signals

HEALTH = '"kind": "health"'


def test_a_terminal_that_hangs_up_ends_a_run_with_verdict_json_and_report(tmp_path: Path) -> None:
    out, page = tmp_path / "out.json", tmp_path / "out.html"
    argv = ["run", "-i", "virtual", "-c", "silent", "--quiet", "--sink", "jsonl:-"]
    command = [sys.executable, "-m", "monitor.cli", *argv, "--json", str(out), "--html", str(page)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert HEALTH in process.stdout.readline()
        process.send_signal(signal.SIGHUP)  # the kernel's
        process.send_signal(signal.SIGHUP)  # the shell's
        rest, words = process.communicate(timeout=60.0)
    assert process.returncode == 3  # nothing was judged
    assert HEALTH in rest
    assert "not judged" in words
    (recording,) = json.loads(out.read_text())["recordings"]
    assert recording["completed"] is False
    assert "</html>" in page.read_text()


def test_a_hang_up_that_is_ignored_stays_ignored() -> None:
    stopped: list[int] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_by_signals(lambda number, _: stopped.append(number)):
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGTERM)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert stopped == [signal.SIGTERM]
