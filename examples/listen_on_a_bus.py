"""Listen on a bus with python-can, beside a logger: a drive is played into a virtual bus.

    python examples/listen_on_a_bus.py

On a real bus take ``can.Bus(interface="socketcan", channel="can0")`` and drop the player.
"""

import time
from itertools import takewhile
from pathlib import Path

import can

from monitor import Code, OxygenSensorMonitor

LOG = Path(__file__).parent.parent / "replay_logs" / "delay_symmetric_micro_trips_v108_s112.blf"
SECONDS = 50.0  # of the drive to play
TIMES_REAL = 20.0  # as fast as it was driven


def play(bus: can.BusABC, clock: list[float]) -> None:
    """Send the drive; ``clock`` holds its time now in s."""
    messages = iter(can.LogReader(LOG))
    first = next(messages)
    for message in takewhile(lambda m: m.timestamp < first.timestamp + SECONDS, messages):
        ahead_s = message.timestamp - clock[0]
        if ahead_s > 0.0:
            time.sleep(ahead_s / TIMES_REAL)
            clock[0] = message.timestamp
        bus.send(message)


def tell(code: Code) -> None:
    """Print a code when it comes."""
    print(f"{code.t_s:6.1f} s  {code.code} {code.fault} is {code.state}")


def main() -> None:
    """Judge the drive while it is played."""
    clock = [0.0]  # the drive's, because it is played faster than it was driven
    listener = OxygenSensorMonitor(on_code=tell, monotonic_s=lambda: clock[0])
    with (
        can.Bus("example", interface="virtual") as ear,
        can.Bus("example", interface="virtual", preserve_timestamps=True) as mouth,
    ):
        notifier = can.Notifier(ear, [listener], timeout=0.05)
        play(mouth, clock)
        time.sleep(0.5)
        notifier.stop()
    print(listener.verdict)


if __name__ == "__main__":
    main()
