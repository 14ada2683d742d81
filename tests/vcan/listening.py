"""Whether a program has come to listen on a CAN bus; runs where one is up, see ``guest``."""

import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
QUIET_SHARE = 0.1  # of one CPU: a listener that waits for frames, all its imports done


def wait_until_listening(listener: subprocess.Popen[bytes], patience_s: float) -> None:
    """Return once a CAN socket is bound and the listener has come to rest; raises TimeoutError."""
    deadline_s = time.monotonic() + patience_s
    while time.monotonic() < deadline_s:
        if listener.poll() is not None:
            raise TimeoutError(f"the listener ended with {listener.returncode} before any frame")
        before = cpu_time_s(listener.pid)
        time.sleep(1.0)
        if n_receivers() > 0 and cpu_time_s(listener.pid) - before < QUIET_SHARE:
            return
    raise TimeoutError(f"nobody listened on vcan0 within {patience_s} s")


def wait_until(condition: Callable[[], object], patience_s: float) -> None:
    """Return once the condition holds, at the latest after ``patience_s``."""
    until_s = time.monotonic() + patience_s
    while not condition() and time.monotonic() < until_s:
        time.sleep(0.5)


def n_receivers() -> int:
    """Return how many receive filters the kernel's CAN sockets have set."""
    for line in Path("/proc/net/can/stats").read_text(encoding="ascii").splitlines():
        if "current receive list entries" in line:
            return int(line.split()[0])
    return 0


def cpu_time_s(pid: int) -> float:
    """Return the CPU time a process has used, 0 once it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S  # utime, stime
