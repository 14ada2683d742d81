"""Play a log into vcan0 while ``o2mon run`` and the example in C listen there.

    python two_monitors.py LOG PROGRAM OUT

``o2mon run --transmit`` sends on vcan0, the program on vcan1. OUT gets the payloads of the status
frames of both, as JSON. Runs where both buses are up; see ``guest``.
"""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
from listening import n_receivers, wait_until, wait_until_listening

STATUS = [{"can_id": 0x5C0, "can_mask": 0x7FF, "extended": False}]
O2MON = [sys.executable, "-m", "monitor.cli", "run", "-i", "socketcan", "-c", "vcan0", "--transmit"]
PATIENCE_S = 90.0
N_MESSAGES = 7  # that the program asks for
DRAIN_EACH = 50  # frames played, so that no socket's buffer runs over


def main() -> int:
    """Return 0 when the log was played to both."""
    log, program, out = sys.argv[1:]
    with can.LogReader(log) as reader:
        frames = list(reader)
    with subprocess.Popen([*O2MON, "--quiet"]) as python:
        try:
            wait_until_listening(python, PATIENCE_S)
            before = n_receivers()
            with subprocess.Popen([program, "vcan0", "vcan1"]) as in_c:
                try:
                    wait_until(lambda: n_receivers() >= before + N_MESSAGES, PATIENCE_S)
                    Path(out).write_text(json.dumps(played(frames)), encoding="ascii")
                finally:
                    in_c.terminate()
            python.send_signal(signal.SIGINT)
            python.wait(timeout=PATIENCE_S)
        finally:
            python.kill()
    return 0


def played(frames: list[can.Message]) -> dict[str, list[str]]:
    """Play frames at their pace; return the status frames on each bus while they came."""
    found: dict[str, list[str]] = {"vcan0": [], "vcan1": []}
    ears = [can.Bus(interface="socketcan", channel=name, can_filters=STATUS) for name in found]
    for k, frame in enumerate(can.MessageSync(frames)):
        ears[0].send(frame)
        if k % DRAIN_EACH == 0:
            drain(ears, found)
    time.sleep(0.3)  # less than the silence after which the monitors move time on themselves
    drain(ears, found)
    for ear in ears:
        ear.shutdown()
    return found


def drain(ears: list[can.BusABC], found: dict[str, list[str]]) -> None:
    """Take what has come on each bus."""
    for ear, payloads in zip(ears, found.values(), strict=True):
        while (frame := ear.recv(0.0)) is not None:
            payloads.append(frame.data.hex())


if __name__ == "__main__":
    sys.exit(main())
