"""Stands in for your ECU program: it sends on a CAN bus what an ECU sent in a recorded drive,
and answers the monitor's fault flag.

python ecu.py LOG [SECONDS [TIMES_REAL]]; the bus is that of CAN_INTERFACE and CAN_CHANNEL
"""

import sys
import time

import can

STATUS = 0x5C0  # of the monitor; the lowest bit is its fault flag
REACTION = can.Message(arbitration_id=0x600, data=b"\1", is_extended_id=False)  # open loop


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
            told = bus.recv(0)
            if told and told.arbitration_id == STATUS and told.data[0] & 1:
                bus.send(REACTION)


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
