"""A bus that plays messages from memory as fast as they are read; None stands for 0.1 s silence."""

from collections.abc import Iterable

import can

from monitor.bus.loop import Loop

SILENCE_S = 0.1


class Played(can.BusABC):
    """Its clock follows the messages; the loop is stopped where they end."""

    def __init__(self, messages: Iterable[can.Message | None]) -> None:
        super().__init__(channel="played")
        self.channel_info = "played from memory"
        self.now_s = 0.0
        self.sent = 0
        self.loop: Loop | None = None
        self._messages = iter(messages)
        self._first_s: float | None = None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        for message in self._messages:
            if message is None:
                self.now_s += SILENCE_S
            elif message.timestamp > 0.0:
                if self._first_s is None:
                    self._first_s = message.timestamp
                self.now_s = max(self.now_s, message.timestamp - self._first_s)
            return message
        if self.loop:
            self.loop.stop()
        return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent += 1
