"""Diagnostics on the live loop: a tester's frames come in, frames of the answers go out.

Sources: SAE J1979 (services $01 to $0A), ISO 14229-1 (the others, and negative responses).
"""

import math
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Final

from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.bus.diagnostics import obd, uds
from monitor.bus.diagnostics.isotp import Transport
from monitor.bus.diagnostics.state import DEFAULT_SESSION, RefusedError, State
from monitor.bus.polling.answer import EcuAddress
from monitor.decode.obd_answers import Reassembly
from monitor.pipeline.events import Event

DEFAULT_RESPONSE_ID: Final = "7E9"
SESSION_TIMEOUT_S: Final = 5.0  # S3 of ISO 14229-2
FRAMES_PER_S: Final = 100.0  # mean rate accepted from testers; faster frames are ignored
BURST_FRAMES: Final = 50
CONTINUE: Final = b"\x30"  # a flow control frame that continues an answer
LONGEST_FRAME: Final = 8  # bytes; ISO 15765-4 uses classical CAN
NEGATIVE: Final = 0x7F
SERVICE_NOT_SUPPORTED: Final = 0x11
RESPONSE_PENDING: Final = 0x78
CLEARING: Final = (0x04, 0x14)
# Negative responses that are not sent to a functional request: service or subfunction not
# supported, request out of range, subfunction or service not supported in this session.
SILENT_IF_FUNCTIONAL: Final = (0x11, 0x12, 0x31, 0x7E, 0x7F)
SERVICES: Final = {**obd.SERVICES, **uds.SERVICES}


def answer(request: bytes, functional: bool, state: State) -> bytes | None:
    """Return the answer to a request, None for silence.

    functional : the request went to all control units
    """
    if not request:
        return None
    service = SERVICES.get(request[0])
    try:
        if service is None:
            raise RefusedError(SERVICE_NOT_SUPPORTED)
        return service(request, state)
    except RefusedError as refusal:
        if functional and refusal.code in SILENT_IF_FUNCTIONAL:
            return None
        return bytes((NEGATIVE, request[0], refusal.code))


def takes_long(request: bytes, state: State) -> bool:
    """Return whether the answer must wait for a write to disk."""
    if not request or request[0] not in CLEARING:
        return False
    rehearsed = answer(request, False, replace(state, clear=lambda: None))
    return rehearsed is not None and rehearsed[0] != NEGATIVE


class Allowance:
    """A token bucket: ``burst`` frames at once, then ``per_s`` per second."""

    def __init__(self, per_s: float, burst: float) -> None:
        self._per_s, self._burst, self._left = per_s, burst, burst
        self._since_s = -math.inf

    def take(self, now_s: float) -> bool:
        """Take one frame; return False if the bucket is empty."""
        passed_s = max(now_s - self._since_s, 0.0)
        self._left = min(self._left + passed_s * self._per_s, self._burst)
        self._since_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Diagnostics(Attachment):
    """The attachment that answers testers.

    response_id : identifier of the answers in hexadecimal, as ``EcuAddress.answering`` has it
    """

    due_s = math.inf

    def __init__(self, state: State, response_id: str = DEFAULT_RESPONSE_ID) -> None:
        self.state = state
        self._address = address = EcuAddress.answering(response_id)
        self._transport = Transport(
            address.physical, address.response, is_extended=address.is_extended
        )
        self._allowance = Allowance(FRAMES_PER_S, BURST_FRAMES)
        self._received: deque[Frame] = deque(maxlen=BURST_FRAMES)
        self._pending: tuple[bytes, bool] | None = None  # request and functional; "pending" sent
        self._session_ends_s = math.inf

    @property
    def identifiers(self) -> Collection[tuple[int, bool]]:
        """Return the identifiers of requests to all ECUs and to this monitor."""
        address = self._address
        return [(i, address.is_extended) for i in (address.functional, address.physical)]

    def receive(self, frame: Frame) -> None:
        """Keep a tester's frame for ``work``."""
        self._received.append(frame)

    def push(self, event: Event) -> None:
        """Take an event of the pipeline."""
        self.state.push(event)

    def work(self, now_s: float) -> Iterable[Frame]:
        """Return the frames that are due, among them answers to the kept frames."""
        if self._pending:
            (request, is_functional), self._pending = self._pending, None
            self._answer(request, is_functional, now_s)
        while self._received:
            self._take(self._received.popleft(), now_s)
        sent = self._transport.frames()
        self.due_s = now_s + (0.0 if self._pending else self._transport.wait_s)
        address = self._address
        return [Frame(0, address.response, address.is_extended, data) for data in sent]

    def _take(self, frame: Frame, now_s: float) -> None:
        is_awaited = self._transport.is_waiting and frame.data[:1] == CONTINUE
        if len(frame.data) > LONGEST_FRAME or not (is_awaited or self._allowance.take(now_s)):
            return
        is_functional = frame.can_id == self._address.functional
        receive = Reassembly().push if is_functional else self._transport.receive
        request = receive(frame.data)
        if request is None or self._pending or self._transport.is_sending:  # one answer at a time
            return
        if now_s >= self._session_ends_s:
            self.state.session = DEFAULT_SESSION
        if takes_long(request, self.state):
            self._pending = request, is_functional
            self._transport.send(bytes((NEGATIVE, request[0], RESPONSE_PENDING)))
        else:
            self._answer(request, is_functional, now_s)

    def _answer(self, request: bytes, is_functional: bool, now_s: float) -> None:
        response = answer(request, is_functional, self.state)
        is_default = self.state.session == DEFAULT_SESSION
        self._session_ends_s = math.inf if is_default else now_s + SESSION_TIMEOUT_S
        if response is not None:
            self._transport.send(response)
