"""Keeps the page's server running: ``python -m monitor.bus.live.keeper SOCKET HOST``.

The loop starts the keeper before it takes its CPU and priority. Starting a server from within the
loop would delay samples, and the server would inherit the loop's priority. Standard input is the
loop's pipe, which every server reads. The keeper writes each server's process number to standard
output and ends with the loop.
"""

import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

NICE: Final = 10  # below the loop
FIRST_WAIT_S: Final = 0.5  # before a dead server is started again; doubles every time
LAST_WAIT_S: Final = 60.0
STEADY_S: Final = 60.0  # a server that ran this long resets the wait


def main() -> None:
    """Start servers until the loop closes the pipe."""
    number, host = sys.argv[1:]
    step_back()
    # -P: do not import modules from the working folder
    keep([sys.executable, "-P", "-m", "monitor.bus.live", number, host], int(number))


def keep(command: Sequence[str], number: int) -> None:
    """Run a command with an inherited socket again and again while the loop lives."""
    wait_s = FIRST_WAIT_S
    while True:
        began_s = time.monotonic()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, pass_fds=[number]) as server:
            with suppress(BrokenPipeError):  # the loop has ended; the server ends, too
                os.write(sys.stdout.fileno(), b"%d\n" % server.pid)
            server.wait()
        if time.monotonic() - began_s >= STEADY_S:
            wait_s = FIRST_WAIT_S
        if has_ended(wait_s):
            return
        wait_s = min(2.0 * wait_s, LAST_WAIT_S)


def has_ended(wait_s: float) -> bool:
    """Return whether the loop closes the pipe within ``wait_s``."""
    closed = select.poll()
    closed.register(sys.stdin.fileno(), 0)  # report only that it is closed
    return bool(closed.poll(wait_s * 1000.0))


def step_back() -> None:
    """Give up a real-time priority inherited from the loop."""
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)


if __name__ == "__main__":
    main()
