"""Run a monitor with its live page; when interrupted, fetch what a browser is sent first.

    python watch_page.py URL STATE.json MONITOR ARGUMENT…

Then the monitor is interrupted as well; its exit code is this program's. See ``play_and_monitor``.
"""

import argparse
import signal
import subprocess
import urllib.request
from pathlib import Path

TIMEOUT_S = 30.0


def main() -> int:
    """Return the monitor's exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url")
    parser.add_argument("state", type=Path)
    parser.add_argument("monitor", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    with subprocess.Popen(options.monitor) as monitor:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        signal.sigwait({signal.SIGINT})
        try:
            options.state.write_bytes(first_event(options.url))
        finally:
            monitor.send_signal(signal.SIGINT)
        return monitor.wait(TIMEOUT_S)


def first_event(url: str) -> bytes:
    """Return the data of the stream's first event."""
    with urllib.request.urlopen(f"{url}events", timeout=TIMEOUT_S) as stream:
        for line in stream:
            if line.startswith(b"data: "):
                return bytes(line.removeprefix(b"data: "))
    raise RuntimeError("the stream has ended without an event")


if __name__ == "__main__":
    raise SystemExit(main())
