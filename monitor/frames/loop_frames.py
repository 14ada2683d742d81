"""Frames that the monitor makes itself: time, state of its bus, cleared codes, gaps of a log.

They pass through pipeline and recording like received frames, so a replay of the recording gives
exactly the same events. They use the last 29-bit identifiers, of lowest priority, which nothing on
a bus should use. The loop never sends them and refuses such identifiers from a bus.
"""

from typing import Final

from monitor.base.types import Frame

TIME_MARK_ID: Final = 0x1FFFFFFF  # no data; its time moves the sample grid on
BUS_STATE_ID: Final = 0x1FFFFFFE  # one byte: 1 the monitor is off the bus, 0 it is on it again
CLEARED_ID: Final = 0x1FFFFFFD  # no data; a tester has cleared the codes
LOG_GAP_ID: Final = 0x1FFFFFFC  # no data; of the time before it nothing is known
FIRST_ID: Final = LOG_GAP_ID


def time_mark(t_ns: int) -> Frame:
    """Return the frame that moves time on while the bus is silent."""
    return Frame(t_ns, TIME_MARK_ID, True, b"")


def bus_state(t_ns: int, *, off: bool) -> Frame:
    """Return the frame that reports whether the monitor is off the bus."""
    return Frame(t_ns, BUS_STATE_ID, True, bytes([off]))


def codes_cleared(t_ns: int) -> Frame:
    """Return the frame that reports codes cleared by a tester."""
    return Frame(t_ns, CLEARED_ID, True, b"")


def log_gap(t_ns: int) -> Frame:
    """Return the frame behind a pause of a whole log of which nothing is known."""
    return Frame(t_ns, LOG_GAP_ID, True, b"")


def is_own(frame: Frame) -> bool:
    """Return whether a frame has an identifier of the loop's frames."""
    return frame.can_id >= FIRST_ID and frame.is_extended
