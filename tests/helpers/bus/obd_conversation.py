"""A poller and an ECU in conversation."""

from typing import Any

from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of
from monitor.bus.polling.pids import wanted
from monitor.bus.polling.poller import ObdPoller
from monitor.decode.log_blocks import EngineAnswers
from monitor.frames.blocks import block_of, frames_of
from monitor.frames.logs import frame_of
from tests.helpers.bus.obd_ecu import ObdEcu, SimulatedBus
from tests.helpers.logs.bus_maps import OBD, Decoding

PARAMETERS = wanted(OBD, OBD.names)


class Conversation:
    """A poller and an ECU on a simulated bus, with what the decoder makes of it."""

    def __init__(self, ecu: ObdEcu, **options: Any) -> None:
        self.said: list[str] = []
        self.poller = ObdPoller(PARAMETERS, say=self.said.append, **options)
        self.ecu = ecu
        self.bus = SimulatedBus(ecu)
        self.decoding = Decoding(OBD, OBD.names)
        self._answers = EngineAnswers(self.decoding.decoder.plans)
        self._values: dict[str, list[float]] = {n: [] for n in self.decoding.decoder.channels}
        self._n_decoded = 0
        self.frames: list[Frame] = []

    def run(self, seconds: float) -> "Conversation":
        until_s = self.bus.now_s + seconds
        while self.bus.now_s < until_s:
            self._send()
            left_s = min(self.poller.due_s, until_s) - self.bus.now_s
            message = self.bus.recv(min(max(left_s, 0.0), 0.1))
            if message is not None:
                self.frames.append(frame := frame_of(message))
                self.poller.receive(frame)
                self._send()
        return self

    def answered_with(self, answers: list[bytes] | None, seconds: float) -> "Conversation":
        """Go on while the ECU gives these answers to all it is asked, or its own again."""
        self.ecu.override = lambda _: answers
        return self.run(seconds)

    def _send(self) -> None:
        for frame in self.poller.work(self.bus.now_s):
            self.bus.send(message_of(frame))

    @property
    def values(self) -> dict[str, list[float]]:
        new, self._n_decoded = self.frames[self._n_decoded :], len(self.frames)
        for found in self.decoding.push(list(frames_of(self._answers.push(block_of(new))))):
            for name, value in (found or {}).items():
                self._values[name].append(value)
        return self._values

    @property
    def asked(self) -> list[tuple[int, ...]]:
        return [tuple(request[1:]) for _, request in self.ecu.asked]

    @property
    def polled(self) -> set[int]:
        return set(self.poller.schedule.timeouts_s)
