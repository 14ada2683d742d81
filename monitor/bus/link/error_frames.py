"""Meaning of SocketCAN's error frames. Source: Linux, include/uapi/linux/can/error.h."""

from dataclasses import dataclass
from enum import IntFlag
from typing import Final, Literal

State = Literal["active", "warning", "passive", "bus off"]
_ACKNOWLEDGE: Final = (0x19, 0x1B)  # byte 3 of a protocol error: the slot, its delimiter


class ErrorClass(IntFlag):
    """Bits of an error frame's identifier."""

    TX_TIMEOUT = 0x001
    LOST_ARBITRATION = 0x002
    CONTROLLER = 0x004
    PROTOCOL = 0x008
    TRANSCEIVER = 0x010
    NO_ACKNOWLEDGE = 0x020
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    RESTARTED = 0x100


class CanController(IntFlag):
    """Bits of byte 1: the controller's state."""

    RX_OVERFLOW = 0x01
    TX_OVERFLOW = 0x02
    RX_WARNING = 0x04
    TX_WARNING = 0x08
    RX_PASSIVE = 0x10
    TX_PASSIVE = 0x20
    ACTIVE = 0x40


@dataclass(frozen=True, slots=True)
class ErrorFrame:
    """The meaning of one error frame."""

    state: State | None  # new state of the controller, None if the frame does not tell
    overflow: bool  # controller or driver has lost received frames
    no_acknowledge: bool  # no node on the bus acknowledges sent frames


def error_frame(can_id: int, data: bytes) -> ErrorFrame:
    """Return the meaning of an error frame.

    can_id : identifier without flags
    data : bytes of the frame; missing bytes count as 0
    """
    about = CanController(data[1]) if len(data) > 1 and can_id & ErrorClass.CONTROLLER else None
    is_protocol = bool(can_id & ErrorClass.PROTOCOL) and len(data) > 3
    return ErrorFrame(
        _state(ErrorClass(can_id & 0x1FF), about),
        about is not None and bool(about & CanController.RX_OVERFLOW),
        bool(can_id & ErrorClass.NO_ACKNOWLEDGE) or (is_protocol and data[3] in _ACKNOWLEDGE),
    )


def _state(kind: ErrorClass, about: CanController | None) -> State | None:
    if kind & ErrorClass.BUS_OFF:
        return "bus off"
    if about is not None and about & (CanController.RX_PASSIVE | CanController.TX_PASSIVE):
        return "passive"
    if about is not None and about & (CanController.RX_WARNING | CanController.TX_WARNING):
        return "warning"
    if kind & ErrorClass.RESTARTED or (about is not None and about & CanController.ACTIVE):
        return "active"
    return None
