"""A node of SAE J1939 on the live loop: it claims its address, sends DM1, answers requests.

Sources: SAE J1939-21 (requests, acknowledgement, broadcast announce message), J1939-73 (DM1, DM2,
DM3), J1939-81 (address claim). Messages of more than eight bytes are always broadcast.
"""

import hashlib
import math
import struct
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Final

from monitor.base.errors import O2Error, UsageError
from monitor.base.types import Frame
from monitor.bus.diagnostics.state import RefusedError, State
from monitor.bus.j1939.codes import dm1, dm2, has_active
from monitor.decode.parameter_groups import mask_of
from monitor.pipeline.events import DtcChanged, Event

DM1, DM2, DM3 = 0xFECA, 0xFECB, 0xFECC
REQUEST, CLAIM, ACKNOWLEDGEMENT, ANNOUNCE, DATA = 0xEA00, 0xEE00, 0xE800, 0xEC00, 0xEB00
EVERYBODY, NULL = 0xFF, 0xFE  # addresses: all nodes; a node that has none
POSITIVE, NEGATIVE, DENIED, BUSY = 0, 1, 2, 3  # control bytes of an acknowledgement
DM1_S: Final = 1.0  # interval of DM1
CLAIM_S: Final = 0.25  # in which another node may contend for the address
PACKET_S: Final = 0.05  # least interval of the packets of a broadcast
PACKET: Final = 7  # bytes
MOST_REQUESTS: Final = 50  # that wait for an answer
PRIORITY, SLOW_PRIORITY = 6, 7


def name_of(identity: str) -> bytes:
    """Return the node's NAME: no manufacturer's code, an identity number of 21 bits from a text."""
    number = int.from_bytes(hashlib.sha256(identity.encode()).digest()[:3], "big") & 0x1FFFFF
    not_available, function = 0x7FF, 0xFF
    return (number | not_available << 21 | function << 40).to_bytes(8, "little")


def address(text: str) -> int:
    """Return a source address given in hexadecimal.

    Raises UsageError unless it is 00 to FD.
    """
    try:
        value = int(text, 16)
    except ValueError:
        value = -1
    if not 0 <= value <= 0xFD:
        raise UsageError(f"--j1939 {text}: an address from 00 to FD is wanted, in hexadecimal")
    return value


class Node:
    """The attachment.

    state : fault memory, and whether codes may be cleared
    own : source address
    say : receives the message that the address is lost
    """

    def __init__(self, state: State, own: int, say: Callable[[str], None]) -> None:
        self._state, self._own, self._say = state, own, say
        self._name = name_of(state.identity.vin or state.identity.model_sha256)
        self._received: deque[Frame] = deque(maxlen=MOST_REQUESTS)
        self._sending: deque[Frame] = deque()  # packets of broadcasts, PACKET_S apart
        self._next_packet_s = -math.inf
        self._claimed_s: float | None = None
        self._is_lost = False
        self._dm1_s = -math.inf
        self.due_s = -math.inf
        self.identifiers: Collection[tuple[int, bool]] = [
            (_identifier(group, target, source), True)
            for group, target in ((REQUEST, own), (REQUEST, EVERYBODY), (CLAIM, EVERYBODY))
            for source in range(0x100)
        ]
        self.groups = {(i & mask_of(i), mask_of(i)) for i, _ in self.identifiers}

    def receive(self, frame: Frame) -> Iterable[Frame]:
        """Keep a frame for ``work``."""
        self._received.append(frame)
        return ()

    def push(self, event: Event) -> None:
        """Send DM1 at once if a code changes."""
        if isinstance(event, DtcChanged):
            self._dm1_s = -math.inf

    def close(self) -> None:
        """Do nothing: it holds no resources."""

    def work(self, now_s: float) -> Iterable[Frame]:
        """Return the frames that are due: the claim, DM1, answers and packets."""
        if self._is_lost:
            self._received.clear()
            self.due_s = math.inf
            return ()
        sent = []
        if self._claimed_s is None:
            self._claimed_s = now_s
            sent.append(self._claim(self._own))
        while self._received:
            sent += self._answer(self._received.popleft())
        if self._is_lost:
            return sent
        if now_s >= self._claimed_s + CLAIM_S and now_s >= self._dm1_s and not self._sending:
            self._dm1_s = now_s + DM1_S
            sent += self._broadcast(DM1, dm1(self._state.store))
        if self._sending and now_s >= self._next_packet_s:
            self._next_packet_s = now_s + PACKET_S
            sent.append(self._sending.popleft())
        self.due_s = max(self._dm1_s, self._claimed_s + CLAIM_S)
        if self._sending:
            self.due_s = min(self.due_s, self._next_packet_s)
        return sent

    def _answer(self, frame: Frame) -> Iterator[Frame]:
        source = frame.can_id & 0xFF
        if frame.can_id >> 16 & 0xFF == CLAIM >> 8:
            yield from self._contend(source, frame.data)
            return
        if len(frame.data) < 3 or source == self._own:
            return
        group = int.from_bytes(frame.data[:3], "little")
        is_to_all = frame.can_id >> 8 & 0xFF == EVERYBODY
        if group == CLAIM:
            yield self._claim(self._own)
        elif group == DM1:
            self._dm1_s = -math.inf
        elif group == DM2:
            yield from self._broadcast(DM2, dm2(self._state.store))
        elif group == DM3:
            yield self._acknowledge(self._clear(), group, source)
        elif not is_to_all:
            yield self._acknowledge(NEGATIVE, group, source)

    def _contend(self, source: int, name: bytes) -> Iterator[Frame]:
        """Defend the address against a higher NAME, give it up to a lower one."""
        if source != self._own or len(name) != 8 or name == self._name:
            return
        if int.from_bytes(self._name, "little") < int.from_bytes(name, "little"):
            yield self._claim(self._own)
            return
        self._is_lost = True
        self._sending.clear()
        self._say(f"J1939 address {self._own:02X} belongs to another node; no DM1 is sent")
        yield self._claim(NULL)

    def _clear(self) -> int:
        """Clear the codes if none is active; return the control byte of the acknowledgement."""
        state = self._state
        if not state.access.is_open:
            return DENIED
        if has_active(state.store):  # DM3 clears previously active codes only
            return NEGATIVE
        try:
            state.check_may_clear()
            state.clear()
        except (RefusedError, O2Error):
            return BUSY
        return POSITIVE

    def _claim(self, source: int) -> Frame:
        return Frame(0, _identifier(CLAIM, EVERYBODY, source), True, self._name)

    def _acknowledge(self, control: int, group: int, asking: int) -> Frame:
        data = bytes((control, 0xFF, 0xFF, 0xFF, asking)) + group.to_bytes(3, "little")
        return Frame(0, _identifier(ACKNOWLEDGEMENT, EVERYBODY, self._own), True, data)

    def _broadcast(self, group: int, data: bytes) -> Iterator[Frame]:
        """Yield a message of eight bytes, or queue the packets of a longer one."""
        if len(data) <= 8:
            yield Frame(0, _identifier(group, group & 0xFF, self._own), True, data)
            return
        packets = [data[i : i + PACKET] for i in range(0, len(data), PACKET)]
        head = struct.pack("<BHBB", 0x20, len(data), len(packets), 0xFF)
        announced = _identifier(ANNOUNCE, EVERYBODY, self._own, SLOW_PRIORITY)
        self._sending.append(Frame(0, announced, True, head + group.to_bytes(3, "little")))
        carrier = _identifier(DATA, EVERYBODY, self._own, SLOW_PRIORITY)
        for number, packet in enumerate(packets, 1):
            content = bytes((number,)) + packet.ljust(PACKET, b"\xff")
            self._sending.append(Frame(0, carrier, True, content))


def _identifier(group: int, target: int, source: int, priority: int = PRIORITY) -> int:
    """Return the identifier of a parameter group with 29 bits."""
    return priority << 26 | (group & 0xFF00) << 8 | target << 8 | source
