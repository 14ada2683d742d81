"""Frames of the loop's own: what it knows of time and of its bus, told to pipeline and recording.

They go the way of received frames, so that a replay of the recording gives exactly the same
events. Their identifiers are the last of the 29-bit ones, with the lowest priority; nothing on a
bus should use them, the loop never sends them, and what comes under them from a bus is refused.
"""

from typing import Final

from monitor.base.types import Frame

TIME_MARK_ID: Final = 0x1FFFFFFF  # no data: only moves time
BUS_STATE_ID: Final = 0x1FFFFFFE  # one byte: 1 the monitor is off the bus, 0 it is back
CLEARED_ID: Final = 0x1FFFFFFD  # no data: a tester has cleared the codes
FIRST_ID: Final = CLEARED_ID


def time_mark(t_ns: int) -> Frame:
    """Return the frame that says what time it is on a silent bus."""
    return Frame(t_ns, TIME_MARK_ID, True, b"")


def bus_state(t_ns: int, *, off: bool) -> Frame:
    """Return the frame that says whether the monitor itself is off the bus."""
    return Frame(t_ns, BUS_STATE_ID, True, bytes([off]))


def codes_cleared(t_ns: int) -> Frame:
    """Return the frame that says that a tester has cleared the codes."""
    return Frame(t_ns, CLEARED_ID, True, b"")


def is_own(frame: Frame) -> bool:
    """Return whether a frame stands under an identifier of the loop's own."""
    return frame.can_id >= FIRST_ID and frame.is_extended


def says_off(frame: Frame) -> bool:
    """Return what a ``bus_state`` frame says."""
    return frame.data == b"\x01"
