"""Play a log into vcan0 at recorded pace while a listener runs, then end the listener.

    python play_and_monitor.py LOG -- LISTENER ARGUMENT…

The listener is interrupted as a user would do it, by SIGINT, right after the last frame; its exit
code is this program's. Runs where vcan0 is up; see ``guest``.
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
QUIET_SHARE = 0.1  # of one CPU: a listener that waits for frames, all its imports done


def main() -> int:
    """Return the listener's exit code, 99 when it never listened or did not end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("listener", nargs="+")
    parser.add_argument("--patience", type=float, default=60.0, help="s to wait for the listener")
    options = parser.parse_args()

    with subprocess.Popen(options.listener) as listener:
        try:
            wait_until_listening(listener, options.patience)
            play(options.log)
            listener.send_signal(signal.SIGINT)
            return listener.wait(timeout=options.patience)
        except (TimeoutError, subprocess.TimeoutExpired) as error:
            print(f"play_and_monitor: {error}", file=sys.stderr)
            return 99
        finally:
            listener.kill()


def play(log: Path) -> None:
    """Send the log's frames to vcan0 at the pace in which they were recorded."""
    player = [sys.executable, "-m", "can.player", "-i", "socketcan", "-c", "vcan0", str(log)]
    subprocess.run(player, check=True)


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


if __name__ == "__main__":
    sys.exit(main())
