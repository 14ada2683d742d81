"""Priority, processor and garbage collection of the live loop's process."""

import gc
import os

from monitor.base.errors import UsageError


def use_priority(priority: int) -> None:
    """Run under SCHED_FIFO at this priority.

    Raises UsageError if the system has no such priority or does not permit it.
    """
    if not hasattr(os, "sched_setscheduler"):
        raise UsageError("--realtime: this system has no SCHED_FIFO")
    least, most = (f(os.SCHED_FIFO) for f in (os.sched_get_priority_min, os.sched_get_priority_max))
    if not least <= priority <= most:
        raise UsageError(f"--realtime {priority}: a priority from {least} to {most} is wanted")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        raise UsageError(
            f"--realtime {priority}: not permitted; run as root, or set LimitRTPRIO={priority} in "
            f"the service's unit, or `ulimit -r {priority}`"
        ) from None


def use_cpu(cpu: int) -> None:
    """Run on this processor only.

    Raises UsageError if there is no such processor or it is not permitted.
    """
    if not hasattr(os, "sched_setaffinity"):
        raise UsageError("--cpu: this system cannot bind a process to a processor")
    allowed = sorted(os.sched_getaffinity(0))
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, ValueError, OverflowError):
        raise UsageError(f"--cpu {cpu}: not to be had; there are {allowed}") from None


def settle() -> None:
    """Exempt all loaded objects from garbage collection: they cause its longest pauses."""
    gc.collect()
    gc.freeze()
