"""ISO 15765-2 for one address: can-isotp's state machines without threads.

can-isotp measures the standard's timeouts with the monotonic clock.
"""

import logging
import math
from collections import deque
from typing import Final

import isotp

LONGEST_REQUEST: Final = 64  # bytes; a longer request is refused at its first frame (overflow)
LEAST_SEPARATION_MS: Final = 2  # between consecutive frames, even if the tester allows less
PADDING: Final = 0xCC  # fills every frame to eight bytes, as ISO 15765-4 asks
FLOW_CONTROL: Final = 0x3  # first four bits of a frame
LONGEST_SEPARATION: Final = 0x7F  # 127 ms; reserved values mean the same

_LOG: Final = "monitor.bus.diagnostics.isotp"
logging.getLogger(_LOG).setLevel(logging.CRITICAL + 1)  # a transfer that fails is let go


class Transport:
    """Turns frames into requests and answers into frames, one at a time."""

    def __init__(self, request_id: int, response_id: int, *, is_extended: bool) -> None:
        modes = isotp.AddressingMode
        mode = modes.Normal_29bits if is_extended else modes.Normal_11bits
        self._request_id, self._is_extended = request_id, is_extended
        self._received: deque[isotp.CanMessage] = deque()
        self._sent: list[bytes] = []
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda _: self._received.popleft() if self._received else None,
            txfn=lambda message: self._sent.append(bytes(message.data)),
            address=isotp.Address(mode, rxid=request_id, txid=response_id),
            params={
                "max_frame_size": LONGEST_REQUEST,
                "blocksize": 0,
                "stmin": 0,
                "tx_padding": PADDING,
                "logger_name": _LOG,
                "wait_func": lambda _: None,
            },
        )

    @property
    def is_sending(self) -> bool:
        """Return whether an answer is being sent."""
        return self._layer.transmitting()

    @property
    def is_waiting(self) -> bool:
        """Return whether the answer waits for a flow control frame."""
        return self._layer.tx_state is self._layer.TxState.WAIT_FC

    @property
    def wait_s(self) -> float:
        """Return the time in s until ``frames`` must be called; inf if it need not be."""
        layer = self._layer
        waits = [
            t.remaining() for t in (layer.timer_rx_fc, layer.timer_rx_cf) if not t.is_stopped()
        ]
        delay_s = layer.next_cf_delay()
        return min((*waits, math.inf if delay_s is None else delay_s)) + 1e-4

    def receive(self, data: bytes) -> bytes | None:
        """Take a frame of the tester; return the request if the frame completes it."""
        self._received.append(
            isotp.CanMessage(
                arbitration_id=self._request_id,
                dlc=len(data),
                data=_paced(data),
                extended_id=self._is_extended,
            )
        )
        self._layer.process()
        request = None
        while self._layer.available():
            request = self._layer.recv()
        return None if request is None else bytes(request)

    def send(self, answer: bytes) -> None:
        """Begin to send an answer."""
        self._layer.send(answer)

    def frames(self) -> list[bytes]:
        """Return the frames that are due."""
        self._layer.process()
        sent = self._sent[:]
        self._sent.clear()
        return sent


def _paced(data: bytes) -> bytes:
    """Return a flow control frame whose separation is at least ``LEAST_SEPARATION_MS``.

    Microseconds are raised to it; reserved values count as the longest, as the standard says.
    """
    if len(data) < 3 or data[0] >> 4 != FLOW_CONTROL:
        return data
    wanted = data[2]
    if 0xF1 <= wanted <= 0xF9:
        wanted = 0
    separation = min(max(wanted, LEAST_SEPARATION_MS), LONGEST_SEPARATION)
    return data[:2] + bytes((separation,)) + data[3:]
