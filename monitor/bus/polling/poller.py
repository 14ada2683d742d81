"""Polls OBD-II parameters from the engine, for vehicles that broadcast no useful signals.

There is one request at a time, with up to six PIDs. The next one follows the answer or a timeout,
within the rate. The pipeline takes the answers apart, as those to any other tester.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Final

from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.bus.polling.answer import (
    BUSY,
    FLOW_CONTROL,
    FUNCTIONAL,
    FUNCTIONAL_29,
    NEGATIVE,
    PENDING,
    SERVICE,
    EcuAddress,
    request_of,
)
from monitor.bus.polling.pids import MOST_PIDS, ObdParameter
from monitor.bus.polling.schedule import Schedule
from monitor.decode.obd_answers import POSITIVE, Reassembly, values_of

# Tried in this order until one is answered: 11 bits before 29, as in ISO 15765-4.
ADDRESSES: Final = tuple(map(EcuAddress.of, (0x7E0, FUNCTIONAL, 0x18DA10F1, FUNCTIONAL_29)))
DEFAULT_RATE_HZ: Final = 12.0  # requests; an ECU answers about 10 to 20 per second
TIMEOUT_S: Final = 0.25  # an ECU has 0.05 s by the standard; gateways and adapters add to it
PENDING_S: Final = 5.0  # the same after "response pending", P2* of ISO 15765-4
BACK_OFF_S: Final = 0.25  # first pause; it doubles
MOST_BACK_OFF_S: Final = 5.0
SILENT_MOST: Final = 4  # requests in a row without an answer after which polling starts anew
NOTHING_S: Final = 30.0  # with no supported PID, the bitmaps are read again after this time


@dataclass(slots=True)
class PollCounters:
    """Counts of requests by outcome."""

    requests: int = 0
    answers: int = 0
    silent: int = 0
    busy: int = 0
    refused: int = 0  # other negative answers
    malformed: int = 0  # incomplete or unexpected answers


class ObdPoller(Attachment):
    """The attachment that polls OBD-II parameters.

    parameters : from ``pids.wanted``
    addresses : tried in turn until one is answered
    rate_hz : most requests per second
    say : receives a line about the supported parameters, and one at the end
    """

    def __init__(
        self,
        parameters: Sequence[ObdParameter],
        *,
        addresses: Sequence[EcuAddress] = ADDRESSES,
        rate_hz: float = DEFAULT_RATE_HZ,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.counters = PollCounters()
        self.schedule = Schedule(parameters, say)
        self._say = say
        self._addresses, self._at = tuple(addresses), 0
        self._pause_s = 1.0 / rate_hz
        self._reassembly = Reassembly()
        self._asked: tuple[int, ...] = ()  # PIDs of the open request, empty if there is none
        self._sent_s = self._deadline_s = self._next_s = -math.inf
        # what the next ``work`` is to do: wait for so long, or rest before the next request
        self._wait_s: float | None = None
        self._rest_s: float | None = None
        self._flow_control = False
        self._silent = self._busy = 0  # times in a row

    @property
    def identifiers(self) -> Collection[tuple[int, bool]]:
        """Return the identifiers of possible answers."""
        return {(address.response, address.is_extended) for address in self._addresses}

    @property
    def due_s(self) -> float:
        """Return the time of the next request, or of the timeout of the open one."""
        return self._deadline_s if self._asked else self._next_s

    @property
    def interval_s(self) -> float:
        """Return the approximate interval in s at which polling brings the fastest signals.

        A PID is polled in inverse proportion to its timeout.
        """
        timeouts_s = [parameter.timeout_s for parameter in self.schedule.parameters]
        shares = sum(min(timeouts_s) / timeout_s for timeout_s in timeouts_s)
        return shares * self._pause_s / MOST_PIDS

    def close(self) -> None:
        """Say the counts."""
        told = asdict(self.counters)
        line = f"OBD-II: {told.pop('requests')} requests, {told.pop('answers')} answered"
        self._say(", ".join([line, *(f"{name} {n}" for name, n in told.items() if n)]))

    def receive(self, frame: Frame) -> None:
        """Take a frame of the answer to the open request."""
        address = self._addresses[self._at]
        if not self._asked or frame[1:3] != (address.response, address.is_extended):
            return
        data = frame.data
        kind = data[0] >> 4 if data else -1
        if kind in (0, 1):
            service, about = (data[1 + kind :] + b"\0\0")[:2]
            if kind == 0 and (service, about) == (NEGATIVE, SERVICE):
                self._negative(data[3] if len(data) > 3 else 0)
                return
            if service != POSITIVE or about not in self._asked:
                return  # the answer to another tester
        was_running = self._reassembly.is_running
        answer = self._reassembly.push(data)
        if answer is not None:
            self._answered(answer)
        elif self._reassembly.is_running:
            self._flow_control = self._flow_control or kind == 1
            self._wait_s = TIMEOUT_S
        elif was_running:
            self.counters.malformed += 1

    def work(self, now_s: float) -> list[Frame]:
        """Return the frames to send now: flow control or the next request."""
        frames = []
        if self._flow_control:
            self._flow_control = False
            frames.append(self._frame(self._addresses[self._at].physical, FLOW_CONTROL))
        if self._wait_s is not None:
            self._deadline_s, self._wait_s = now_s + self._wait_s, None
        if self._asked and now_s >= self._deadline_s:
            self._nothing_came()
        if self._rest_s is not None:
            rested_s, self._rest_s = now_s + self._rest_s, None
            self._next_s = max(rested_s, self._sent_s + self._pause_s)
        if not self._asked and now_s >= self._next_s:
            self._asked = self.schedule.choose(now_s)
            if self._asked:
                self._sent_s, self._deadline_s = now_s, now_s + TIMEOUT_S
                self.counters.requests += 1
                request = request_of(self._asked)
                frames.append(self._frame(self._addresses[self._at].request, request))
            else:
                self.schedule.begin()
                self._next_s = now_s + NOTHING_S
        return frames

    def _frame(self, can_id: int, data: bytes) -> Frame:
        return Frame(0, can_id, self._addresses[self._at].is_extended, data)

    def _done(self, rest_s: float) -> None:
        """Close the open request; the next one follows after a rest.

        Until there was an answer, it goes to the next address.
        """
        if not self.counters.answers:
            self._at = (self._at + 1) % len(self._addresses)
        self._asked, self._rest_s = (), rest_s
        self._reassembly.is_running = self._flow_control = False

    def _answered(self, answer: bytes) -> None:
        """Take a complete answer."""
        values = values_of(answer, self._asked)
        if not values:
            self.counters.malformed += 1
            return
        self.counters.answers += 1
        self._silent = self._busy = 0
        self.schedule.answered(self._asked, dict(values))
        self._done(0.0)

    def _negative(self, code: int) -> None:
        if code == PENDING:
            self._deadline_s = self._sent_s + PENDING_S
            return
        if code == BUSY:
            self.counters.busy += 1
        else:
            self.counters.refused += 1
            self._silent = 0
            self.schedule.refused(self._asked)
        self._done(_back_off_s(self._busy))
        self._busy += 1

    def _nothing_came(self) -> None:
        self.counters.silent += 1
        self._silent += 1
        if self._silent >= SILENT_MOST:
            self.schedule.begin()
        else:
            self.schedule.silent(self._asked, self._silent)
        self._done(_back_off_s(self._silent - 2) if self._silent > 1 else 0.0)


def _back_off_s(n: int) -> float:
    """Return the pause in s after ``n`` earlier pauses in a row."""
    return float(min(BACK_OFF_S * 2.0 ** min(n, 10), MOST_BACK_OFF_S))
