"""A bench on two virtual buses: player into vcan0, gateway with a scenario to vcan1, monitor there.

    python bench.py LOG SCENARIO FOLDER SECONDS

Shortly before the log ends a UDS tester on vcan1 and an OBD tester on vcan0, behind the gateway,
ask for codes, and a browser fetches the live page. FOLDER then holds run.json and recorded.log of
the monitor, inject.txt of the gateway and clients.json of what they were told. Runs where both
buses are up.
"""

import argparse
import json
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import can
import isotp
from listening import wait_until, wait_until_listening
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection

O2MON = [sys.executable, "-m", "monitor.cli"]
SOCKETCAN = ("-i", "socketcan", "-c")
REQUEST_ID, RESPONSE_ID = 0x7E1, 0x7E9
ADDRESS = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=REQUEST_ID, rxid=RESPONSE_ID)
PAGE = "http://127.0.0.1:8765/"
ASK_BEFORE_END_S = 18.0
PATIENCE_S = 90.0
BY_STATUS = 0x04  # pending
PENDING_ANSWER = 0x47  # of service $07


def main() -> int:
    """Return 0 when all of it ran; what it says is the test's matter."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("log", "scenario", "folder"):
        parser.add_argument(name, type=Path)
    parser.add_argument("seconds", type=float, help="length of the log")
    options = parser.parse_args()
    folder: Path = options.folder
    monitor = [*O2MON, "run", *SOCKETCAN, "vcan1", "--transmit", "--live", PAGE[7:-1], "--quiet"]
    monitor += ["--json", str(folder / "run.json"), "--record", str(folder / "recorded.log")]
    gateway = [*O2MON, "inject", *SOCKETCAN, "vcan0", "--to-channel", "vcan1", "--assert"]
    gateway += ["--scenario", str(options.scenario)]
    player = [sys.executable, "-m", "can.player", *SOCKETCAN, "vcan0", str(options.log)]
    returncodes = {}
    with (
        (folder / "run.txt").open("wb") as said,
        (folder / "inject.txt").open("wb") as done,
        subprocess.Popen(monitor, stdout=said, stderr=subprocess.STDOUT) as listening,
        subprocess.Popen(gateway, stdout=done, stderr=subprocess.STDOUT) as between,
    ):
        try:
            for process in (listening, between):
                wait_until_listening(process, PATIENCE_S)
            with subprocess.Popen(player) as playing:
                time.sleep(options.seconds - ASK_BEFORE_END_S)
                wait_until(ask_uds, PATIENCE_S)  # the player lags on a busy machine
                wait_until(shown_codes, PATIENCE_S)  # so does the server
                told = {"uds": ask_uds(), "obd": ask_obd(), "event": first_event()}
                with urllib.request.urlopen(PAGE, timeout=20) as page:
                    told["page"] = page.read().decode("utf-8")
                (folder / "clients.json").write_text(json.dumps(told), encoding="utf-8")
                returncodes["player"] = playing.wait(timeout=PATIENCE_S)
            ended = {"monitor": listening, "gateway": between}
            for process in ended.values():  # at once: silence is a fault of its own
                process.send_signal(signal.SIGINT)
            for name, process in ended.items():
                returncodes[name] = process.wait(timeout=PATIENCE_S)
        finally:
            listening.kill()
            between.kill()
    print(json.dumps(returncodes))
    return 0


def ask_uds() -> dict[str, int]:
    """Return the pending codes and their status as a UDS tester on the monitor's bus reads them."""
    with tester("vcan1") as bus:
        stack = isotp.CanStack(bus, address=ADDRESS)
        with Client(PythonIsoTpConnection(stack), request_timeout=10) as client:
            client.tester_present()
            response = client.get_dtc_by_status_mask(BY_STATUS)
    return {
        f"{dtc.id:06X}": int(dtc.status.get_byte_as_int()) for dtc in response.service_data.dtcs
    }


def ask_obd() -> str:
    """Return the answer to OBD service $07, in hexadecimal, as it comes through the gateway."""
    with tester("vcan0") as bus:
        stack = isotp.CanStack(bus, address=ADDRESS)
        stack.start()
        try:
            stack.send(b"\x07")
            while answer := stack.recv(block=True, timeout=10):
                if answer[0] == PENDING_ANSWER:  # not a late one to the other tester
                    return bytes(answer).hex()
        finally:
            stack.stop()
    return ""


def tester(channel: str) -> can.BusABC:
    """Return a bus that hears the monitor's answers only."""
    answers = [{"can_id": RESPONSE_ID, "can_mask": 0x7FF, "extended": False}]
    return can.Bus(interface="socketcan", channel=channel, can_filters=answers)


def first_event() -> str:
    """Return the data of the first event of the page's stream."""
    with urllib.request.urlopen(f"{PAGE}events", timeout=20) as stream:
        return next(str(line, "utf-8") for line in stream if line.startswith(b"data: "))


def shown_codes() -> list[object]:
    """Return the codes that the page shows."""
    shown = json.loads(first_event().partition("data: ")[2])
    return list(shown.get("memory", {}).get("codes", []))


if __name__ == "__main__":
    sys.exit(main())
