"""``o2mon check --obd`` on vcan0, where an engine ECU answers; its exit code is this program's.

    python -m tests.vcan.check_obd

Runs where vcan0 is up; see ``guest``.
"""

import sys

from monitor import cli
from tests.helpers.bus.obd_ecu import answering, steady_ecu

SECONDS = 3.0

if __name__ == "__main__":
    with answering(steady_ecu(), "vcan0", "socketcan"):
        bus = ["-i", "socketcan", "-c", "vcan0"]
        sys.exit(cli.main(["check", *bus, "--obd", "--seconds", str(SECONDS)]))
