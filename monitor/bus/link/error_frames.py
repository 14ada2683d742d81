"""Meaning of SocketCAN's error frames. Source: Linux, include/uapi/linux/can/error.h."""

from typing import Final, Literal, NamedTuple

State = Literal["active", "warning", "passive", "bus off"]
# bits of the identifier
_CONTROLLER, _PROTOCOL, _NO_ACKNOWLEDGE, _BUS_OFF, _RESTARTED = 0x004, 0x008, 0x020, 0x040, 0x100
# bits of byte 1 in a frame about the controller; warning and passive of receiving and of sending
_OVERFLOW, _WARNING, _PASSIVE, _ACTIVE = 0x01, 0x04 | 0x08, 0x10 | 0x20, 0x40
_ACKNOWLEDGE: Final = (0x19, 0x1B)  # byte 3 of a protocol error: the slot, its delimiter


class ErrorFrame(NamedTuple):
    """The meaning of one error frame."""

    state: State | None  # new state of the controller, None if the frame does not tell
    overflow: bool  # controller or driver has lost received frames
    no_acknowledge: bool  # no node on the bus acknowledges sent frames


def error_frame(can_id: int, data: bytes) -> ErrorFrame:
    """Return the meaning of an error frame.

    can_id : identifier without flags
    data : bytes of the frame; missing bytes count as 0
    """
    about = data[1] if len(data) > 1 and can_id & _CONTROLLER else 0
    place = data[3] if len(data) > 3 and can_id & _PROTOCOL else 0
    told: tuple[tuple[State, int], ...] = (
        ("bus off", can_id & _BUS_OFF),
        ("passive", about & _PASSIVE),
        ("warning", about & _WARNING),
        ("active", can_id & _RESTARTED or about & _ACTIVE),
    )
    return ErrorFrame(
        next((state for state, is_told in told if is_told), None),
        bool(about & _OVERFLOW),
        bool(can_id & _NO_ACKNOWLEDGE) or place in _ACKNOWLEDGE,
    )
