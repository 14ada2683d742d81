"""Keeps the page's server running: ``python -m monitor.bus.live.keeper SOCKET HOST``.

The loop starts it before it takes its place before other processes; to start a server from within
the loop would take longer than a sample may wait, and the server would have the loop's priority.
Its standard input is the loop's pipe, which every server it starts reads. It writes the number of
each to its standard output, and ends with the loop.
"""

import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

NICE: Final = 10  # the loop comes first
FIRST_WAIT_S: Final = 0.5  # before a server that has died is started again; then twice as long
LAST_WAIT_S: Final = 60.0
STEADY_S: Final = 60.0  # of running, after which the waits begin anew


def main() -> None:
    """Start servers until the loop's end of the pipe is closed."""
    number, host = sys.argv[1:]
    step_back()
    # -P: no module of the folder it is started in
    keep([sys.executable, "-P", "-m", "monitor.bus.live", number, host], int(number))


def keep(command: Sequence[str], number: int) -> None:
    """Run a command that is handed a socket again and again, as long as the loop is there."""
    wait_s = FIRST_WAIT_S
    while True:
        began_s = time.monotonic()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, pass_fds=[number]) as server:
            with suppress(BrokenPipeError):  # the loop has ended, and so will the server
                os.write(sys.stdout.fileno(), b"%d\n" % server.pid)
            server.wait()
        if time.monotonic() - began_s >= STEADY_S:
            wait_s = FIRST_WAIT_S
        if has_ended(wait_s):
            return
        wait_s = min(2.0 * wait_s, LAST_WAIT_S)


def has_ended(wait_s: float) -> bool:
    """Return whether the loop has closed its end of the pipe, at the latest after the wait."""
    closed = select.poll()
    closed.register(sys.stdin.fileno(), 0)  # nothing but its being closed
    return bool(closed.poll(wait_s * 1000.0))


def step_back() -> None:
    """Leave the loop its priority, should it have one."""
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)


if __name__ == "__main__":
    main()
