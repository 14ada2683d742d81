"""A real broker for the tests of the MQTT sink.

If it is missing its tests are skipped, or fail if O2_REQUIRE_SERVERS=1.
"""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def program(name: str) -> str:
    """Return the path of a server's program, or skip the test."""
    found = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if found is None:
        reason = f"{name} is not installed; apt-get install mosquitto"
        if os.environ.get("O2_REQUIRE_SERVERS"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def accepts(port: int) -> bool:
    """Return whether a server listens at the port."""
    try:
        socket.create_connection(("127.0.0.1", port), 0.2).close()
    except OSError:
        return False
    return True


def wait_for(condition: Callable[[], bool], seconds: float = 15.0) -> bool:
    """Return whether the condition became true in time."""
    until_s = time.monotonic() + seconds
    while not (now := condition()) and time.monotonic() < until_s:
        time.sleep(0.02)
    return now


@contextmanager
def running(command: list[str], port: int, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a server until the end of the block; it must accept connections."""
    log = folder / f"{Path(command[0]).name}.out"
    with (
        log.open("ab") as out,
        subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT) as process,
    ):
        try:
            assert wait_for(lambda: accepts(port)), log.read_text()
            yield process
        finally:
            process.kill()
