"""A Dask scheduler and workers, each in its own process."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# The project is installed, and its root may be on the path: neither is so for these processes.
_WITHOUT_US = """
import sys
from importlib.util import find_spec
from pathlib import Path
ours = Path(find_spec("monitor").origin).parents[1]
sys.path = [p for p in sys.path if Path(p or ".").resolve() != ours]
sys.meta_path = [f for f in sys.meta_path if "editable" not in getattr(f, "__module__", "")]
assert all(find_spec(name) is None for name in ("monitor", "training", "dbc"))
"""
_MAIN = """
import sys
from distributed.cli import {module}
sys.exit({module}.main())
"""


class Cluster:
    """A scheduler with its workers."""

    def __init__(self, address: str, workers: list[subprocess.Popen[bytes]]) -> None:
        self.address, self.workers = address, workers


@contextmanager
def cluster(folder: Path, workers: int = 2, *, installed: bool = False) -> Iterator[Cluster]:
    """Start scheduler and workers; they end with the context.

    installed : whether they find this project, or have only its dependencies
    """
    file = folder / "scheduler.json"
    log = (folder / "cluster.log").open("wb")
    where = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard"]

    def start(module: str, *options: str) -> subprocess.Popen[bytes]:
        script = ("" if installed else _WITHOUT_US) + _MAIN.format(module=module)
        command = [sys.executable, "-c", script, *where, *options]
        return subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)

    processes = [start("dask_scheduler", "--port", "0")]
    try:
        own = ("--nthreads", "1", "--no-nanny", "--local-directory", str(folder))
        processes += [start("dask_worker", *own) for _ in range(workers)]
        deadline = time.monotonic() + 60
        while not (file.exists() and file.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.05)
        yield Cluster(json.loads(file.read_text())["address"], processes[1:])
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait(10)
        log.close()
