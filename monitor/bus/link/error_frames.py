"""What SocketCAN's error frames say; source: Linux, include/uapi/linux/can/error.h."""

from dataclasses import dataclass
from enum import IntFlag
from typing import Literal

State = Literal["active", "warning", "passive", "bus off"]


class ErrorClass(IntFlag):
    """What an error frame's identifier says."""

    TX_TIMEOUT = 0x001
    LOST_ARBITRATION = 0x002
    CONTROLLER = 0x004
    PROTOCOL = 0x008
    TRANSCEIVER = 0x010
    NO_ACKNOWLEDGE = 0x020
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    RESTARTED = 0x100


class Controller(IntFlag):
    """What byte 1 says of the controller."""

    RX_OVERFLOW = 0x01
    TX_OVERFLOW = 0x02
    RX_WARNING = 0x04
    TX_WARNING = 0x08
    RX_PASSIVE = 0x10
    TX_PASSIVE = 0x20
    ACTIVE = 0x40


@dataclass(frozen=True, slots=True)
class ErrorFrame:
    """One error frame in words."""

    state: State | None  # the controller's new state, None if it says nothing about it
    overflow: bool  # the controller or its driver has lost received frames
    no_acknowledge: bool  # nobody on the bus acknowledges what is sent


def error_frame(can_id: int, data: bytes) -> ErrorFrame:
    """Return what an error frame says.

    can_id : without flags
    data : the frame's bytes; what is missing counts as 0
    """
    about = Controller(data[1]) if len(data) > 1 and can_id & ErrorClass.CONTROLLER else None
    return ErrorFrame(
        _state(ErrorClass(can_id & 0x1FF), about),
        about is not None and bool(about & Controller.RX_OVERFLOW),
        bool(can_id & ErrorClass.NO_ACKNOWLEDGE),
    )


def _state(kind: ErrorClass, about: Controller | None) -> State | None:
    if kind & ErrorClass.BUS_OFF:
        return "bus off"
    if about is not None and about & (Controller.RX_PASSIVE | Controller.TX_PASSIVE):
        return "passive"
    if about is not None and about & (Controller.RX_WARNING | Controller.TX_WARNING):
        return "warning"
    if kind & ErrorClass.RESTARTED or (about is not None and about & Controller.ACTIVE):
        return "active"
    return None
