"""Time and memory, as benchmarks measure them."""

import ctypes
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.outcome import say

Work = Callable[[], Any]


class _MallInfo(ctypes.Structure):
    """struct mallinfo2 of the GNU C library."""

    _names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


def cpu_s(work: Work) -> float:
    """Return the processor time of a call, which other work on the machine hardly changes."""
    begin_s = time.process_time()
    work()
    return time.process_time() - begin_s


def in_turn(works: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """Return the median of what each call returns; in every round each has its turn."""
    found: dict[str, list[float]] = {name: [] for name in works}
    for number in range(rounds):
        for name, work in works.items():
            found[name].append(work())
        say(f"round {number + 1} of {rounds}")
    return {name: statistics.median(values) for name, values in found.items()}


def rss_mb(pid: int | str = "self") -> float:
    """Return the memory that a process has in use now."""
    return _status_mb(pid, "VmRSS")


def heap_kb() -> float:
    """Return what this process has of the GNU C library's heap, see mallinfo2(3)."""
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = _MallInfo
    found = mallinfo()
    return float(found.hblkhd + found.uordblks) / 1e3


def peak_mb(pid: int | str = "self") -> float:
    """Return the most memory that a process has had in use; its parent's does not count."""
    return _status_mb(pid, "VmHWM")


def benchmark_call(name: str, *options: object) -> list[str]:
    """Return the command that runs a benchmark in a process of its own."""
    return [sys.executable, "-m", "benchmarks", name, *map(str, options)]


def _status_mb(pid: int | str, key: str) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition(f"{key}:")[2].split()[0]) / 1024
