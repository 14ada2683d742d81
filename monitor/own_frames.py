"""Frames of the loop's own: what it knows of time and of its bus, told to pipeline and recording.

They go the way of received frames, so that a replay of the recording gives exactly the same
events. Their identifiers are the last of the 29-bit ones, with the lowest priority; nothing on a
bus uses them, and the loop never sends them.
"""

from typing import Final

from monitor.types import Frame

TIME_MARK_ID: Final = 0x1FFFFFFF  # no data: only moves time
BUS_STATE_ID: Final = 0x1FFFFFFE  # one byte: 1 the monitor is off the bus, 0 it is back


def time_mark(t_ns: int) -> Frame:
    """Return the frame that says what time it is on a silent bus."""
    return Frame(t_ns, TIME_MARK_ID, True, b"")


def bus_state(t_ns: int, *, off: bool) -> Frame:
    """Return the frame that says whether the monitor itself is off the bus."""
    return Frame(t_ns, BUS_STATE_ID, True, bytes([off]))


def says_off(frame: Frame) -> bool:
    """Return what a ``bus_state`` frame says."""
    return frame.data == b"\x01"
