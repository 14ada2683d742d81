"""An ELM327 adapter on a pseudo terminal, between a scan tool and a python-can bus.

Only what scan tools need: AT commands are agreed to, requests in hexadecimal become single frames,
and the frames of the answers come back with their headers. Source: Elm Electronics, ELM327 data
sheet.
"""

import os
import threading
import time
import tty

import can

WAIT_S = 0.2  # for a further answer, the adapter's own default
PADDING = b"\xcc"
ANSWERS = range(0x7E8, 0x7F0)
FIRST_FRAME = 1


class Adapter:
    """The commands of the adapter."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self._header = bus, 0x7DF

    def command(self, text: str) -> list[str]:
        """Return the lines that a command is answered with."""
        text = text.replace(" ", "").upper()
        if text.startswith("AT"):
            return [self._setting(text[2:])]
        return self._ask(bytes.fromhex(text)) or ["NO DATA"]

    def _setting(self, text: str) -> str:
        if text.startswith("SH"):
            self._header = int(text[2:], 16)
        return {"Z": "ELM327 v1.5", "RV": "12.6V", "DPN": "A6"}.get(text, "OK")

    def _ask(self, payload: bytes) -> list[str]:
        while self._bus.recv(0.0):
            pass  # what nobody asked for
        self._send(self._header, bytes((len(payload),)) + payload)
        lines: list[str] = []
        until_s = time.monotonic() + WAIT_S
        while time.monotonic() < until_s:
            message = self._bus.recv(until_s - time.monotonic())
            if message is None or message.arbitration_id not in ANSWERS:
                continue
            until_s = time.monotonic() + WAIT_S
            lines.append(f"{message.arbitration_id:03X} {message.data.hex(' ').upper()}")
            if message.data[0] >> 4 == FIRST_FRAME:
                self._send(message.arbitration_id - 8, b"\x30\x00\x00")
        return lines

    def _send(self, can_id: int, data: bytes) -> None:
        self._bus.send(
            can.Message(arbitration_id=can_id, is_extended_id=False, data=data.ljust(8, PADDING))
        )


def terminal_of(bus: can.BusABC) -> str:
    """Serve a terminal in a thread until the process ends; return the terminal's path."""
    own, other = os.openpty()
    tty.setraw(other)
    adapter = Adapter(bus)

    def serve() -> None:
        text = b""
        while True:
            text += os.read(own, 256)
            while b"\r" in text:
                line, _, text = text.partition(b"\r")
                answered = adapter.command(line.decode("ascii", "replace"))
                os.write(own, "".join(f"{each}\r" for each in [*answered, ""]).encode() + b">")

    threading.Thread(target=serve, daemon=True).start()
    return os.ttyname(other)
