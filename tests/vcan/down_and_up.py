"""Take vcan0 down and up, then away and back, under a monitor that listens on it.

    python -m tests.vcan.down_and_up

While the monitor waits for vcan0, ``o2mon check --obd`` polls an ECU there. Prints what both print,
the monitor with ``--sink jsonl:-``. Runs where vcan0 is up and may be changed; see ``guest``.
"""

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import can

from tests.helpers.bus.obd_ecu import answering, steady_ecu
from tests.vcan.listening import n_receivers, wait_until, wait_until_listening

O2MON = [sys.executable, "-m", "monitor.cli"]
BUS = ["-i", "socketcan", "-c", "vcan0"]
CHECK = [*O2MON, "check", *BUS, "--obd", "--seconds", "3"]
MONITOR = [*O2MON, "run", *BUS, "--sink", "jsonl:-"]
PATIENT = "[plausibility]\nstart_patience_s = 300\n"  # silence is no fault, however slow this is
N_FRAMES = 20
DOWN_S = 1.0
BACK_S = 6.0  # longer than the longest wait between two tries to open the bus


def main() -> int:
    """Return the monitor's exit code, 99 when it never listened, 98 when the check failed."""
    settings = Path(tempfile.mkdtemp()) / "patient.toml"
    settings.write_text(PATIENT)
    with subprocess.Popen([*MONITOR, "--config", str(settings)]) as monitor:
        try:
            wait_until_listening(monitor, 60.0)
            send()
            ip("link set dev vcan0 down")
            time.sleep(DOWN_S)
            ip("link set dev vcan0 up")
            ecu = answering(steady_ecu(), "vcan0", "socketcan")
            with ecu, subprocess.Popen(CHECK) as check:
                time.sleep(BACK_S)
                if check.wait(timeout=60.0) != 0:
                    return 98
            send()
            ip("link del dev vcan0")
            time.sleep(DOWN_S)
            ip("link add dev vcan0 type vcan")
            ip("link set dev vcan0 up")
            wait_until(n_receivers, BACK_S)
            send()
            time.sleep(1.0)
            monitor.send_signal(signal.SIGINT)
            return monitor.wait(timeout=60.0)
        except (TimeoutError, subprocess.TimeoutExpired) as error:
            print(f"down_and_up: {error}", file=sys.stderr)
            return 99
        finally:
            monitor.kill()


def send() -> None:
    """Send frames of the ECU's under an identifier the monitor asks for."""
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        for number in range(N_FRAMES):
            bus.send(can.Message(arbitration_id=0xC2, is_extended_id=False, data=bytes([number])))
            time.sleep(0.02)
    time.sleep(0.5)


def ip(words: str) -> None:
    """Run ``ip`` with these words."""
    subprocess.run(["ip", *words.split()], check=True)


if __name__ == "__main__":
    sys.exit(main())
