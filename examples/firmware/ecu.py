"""Stands in for your ECU program: it sends on a CAN bus what an ECU sent in a recorded drive.

python ecu.py LOG [SECONDS [TIMES_REAL]]; the bus is that of CAN_INTERFACE and CAN_CHANNEL
"""

import sys
import time

import can


def main(log: str, seconds: float = 75.0, times_real: float = 1.0) -> None:
    """Send the first seconds of a log, ``times_real`` as fast as they were driven."""
    begin_s = time.monotonic()
    with can.Bus() as bus:
        first_s = None
        for message in can.LogReader(log):
            first_s = message.timestamp if first_s is None else first_s
            at_s = message.timestamp - first_s
            if at_s > seconds:
                break
            time.sleep(max(0.0, begin_s + at_s / times_real - time.monotonic()))
            bus.send(message)


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
