"""An engine ECU that answers OBD-II service 01, on can-isotp; and a bus where time is simulated.

The bytes of each PID follow SAE J1979, written down apart from obd2.dbc.
"""

import heapq
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import can
import isotp
import numpy as np

from monitor.base.types import FloatArray, Frame
from monitor.bus.link.recorder import message_of
from monitor.bus.polling.pids import wanted
from monitor.bus.polling.poller import ObdPoller
from monitor.decode.log_blocks import EngineAnswers
from monitor.frames.blocks import block_of, frames_of
from monitor.frames.logs import frame_of
from tests.helpers.bus.beside import beside
from tests.helpers.logs.bus_maps import OBD, Decoding

Row = Mapping[str, float]
Bytes = Callable[[Row], float | int]


# PID → bytes, value in steps
J1979: dict[int, tuple[int, Bytes]] = {
    0x03: (2, lambda r: (2 if r["closed_loop"] > 0.5 else 4 if r["fuel_cut"] > 0.5 else 1) << 8),
    0x05: (1, lambda r: r["coolant_temperature_degc"] + 40),
    0x06: (1, lambda r: r["lambda_controller"] * 128),
    0x0B: (1, lambda r: r["manifold_pressure_kpa"]),
    0x0C: (2, lambda r: r["engine_speed_rpm"] * 4),
    0x0D: (1, lambda r: r["vehicle_speed_km_h"]),
    0x0F: (1, lambda r: r["manifold_temperature_degc"] + 40),
    0x10: (2, lambda r: r["maf_kg_h"] / 3.6 * 100),
    0x11: (1, lambda r: r["throttle_percent"] * 2.55),
    0x23: (2, lambda r: r["rail_pressure_mpa"] * 100),
    0x24: (4, lambda r: min(round(r["lambda_measured"] * 32768), 65535) << 16),
    0x2E: (1, lambda r: r["purge_duty_percent"] * 2.55),
    0x33: (1, lambda r: r["ambient_pressure_kpa"]),
    0x34: (4, lambda r: min(round(r["lambda_measured"] * 32768), 65535) << 16 | 0x8000),
    0x42: (2, lambda r: r["battery_voltage_v"] * 1000),
    0x44: (2, lambda r: r["lambda_target"] * 32768),
    0x46: (1, lambda r: r["ambient_temperature_degc"] + 40),
    # of four cylinders, gasoline of 745 g/l
    0x5E: (2, lambda r: r["fuel_mass_mg"] * r["engine_speed_rpm"] * 2 * 60 / 745e3 * 20),
}
PARAMETERS = wanted(OBD, OBD.names)
SUPPORTED = tuple(pid for pid in J1979 if pid != 0x24)
STEADY = {
    "closed_loop": 1.0,
    "fuel_cut": 0.0,
    "coolant_temperature_degc": 88.0,
    "lambda_controller": 1.03125,
    "manifold_pressure_kpa": 47.0,
    "engine_speed_rpm": 2100.25,
    "vehicle_speed_km_h": 83.0,
    "manifold_temperature_degc": 31.0,
    "maf_kg_h": 36.0 * 1.1,
    "throttle_percent": 20.0,
    "rail_pressure_mpa": 8.15,
    "lambda_measured": 1.0125732421875,
    "purge_duty_percent": 40.0,
    "ambient_pressure_kpa": 98.0,
    "battery_voltage_v": 13.8,
    "lambda_target": 1.0,
    "ambient_temperature_degc": 18.0,
    "fuel_mass_mg": 22.0,
}


class ObdEcu:
    """Answers service 01 with the row of a drive that holds at the time.

    t_s, drive : (n,) times and canonical signals; NaN is sent as the highest value
    supported : PIDs it has
    at_once : most PIDs it answers in one request; more are refused
    """

    def __init__(
        self,
        t_s: FloatArray,
        drive: Mapping[str, FloatArray],
        *,
        supported: Sequence[int] = SUPPORTED,
        at_once: int = 6,
        requests: Sequence[int] = (0x7DF, 0x7E0),
        response: int = 0x7E8,
    ) -> None:
        self._t_s = t_s
        self._drive = {name: np.nan_to_num(x, nan=1e6) for name, x in drive.items()}
        self.supported, self.at_once = tuple(supported), at_once
        self.requests = list(requests)
        self.response = response
        self.is_extended = response > 0x7FF
        self.asked: list[tuple[float, bytes]] = []  # time and request
        self.override: Callable[[bytes], list[bytes] | None] = lambda _: None
        self._rx: deque[isotp.CanMessage] = deque()
        self._tx: list[bytes] = []
        mode = isotp.AddressingMode.Normal_29bits if self.is_extended else None
        address = isotp.Address(
            mode or isotp.AddressingMode.Normal_11bits, rxid=self.requests[-1], txid=response
        )
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda timeout: self._rx.popleft() if self._rx else None,
            txfn=lambda message: self._tx.append(bytes(message.data)),
            address=address,
            params={"tx_padding": 0xAA},
        )

    def push(self, message: can.Message, now_s: float) -> list[bytes]:
        """Take a frame from the bus; return the payloads it answers with."""
        if message.arbitration_id not in self.requests:
            return []
        self._rx.append(
            isotp.CanMessage(
                arbitration_id=self.requests[-1],
                data=bytes(message.data),
                extended_id=self.is_extended,
            )
        )
        if message.data[0] >> 4 == 0:  # a new request ends an answer whose flow control is lost
            self._layer.stop_sending()
        self._layer.process()
        request = self._layer.recv()
        if request is not None:
            self.asked.append((now_s, bytes(request)))
            for answer in self.answers(bytes(request), now_s):
                self._layer.send(answer)
        self._layer.process()
        sent, self._tx = self._tx, []
        return sent

    def answers(self, request: bytes, now_s: float) -> list[bytes]:
        own = self.override(request)
        if own is not None:
            return own
        pids = request[1:]
        if request[0] != 1 or not pids:
            return []
        if len(pids) > self.at_once:
            return [bytes([0x7F, 0x01, 0x12])]
        known = b"".join(self._data(pid, now_s) for pid in pids)
        return [b"\x41" + known] if known else []

    def _data(self, pid: int, now_s: float) -> bytes:
        if pid % 0x20 == 0:
            bits = sum(1 << (32 - (p - pid)) for p in self.supported if 0 < p - pid <= 32)
            more = any(p - pid > 32 for p in self.supported)
            return bytes([pid]) + (bits | more).to_bytes(4, "big")
        if pid not in self.supported:
            return b""
        n, value_of = J1979[pid]
        at = max(int(np.searchsorted(self._t_s, now_s, side="right")) - 1, 0)
        row = {name: float(x[at]) for name, x in self._drive.items()}
        value = min(max(round(value_of(row)), 0), (1 << 8 * n) - 1)
        return bytes([pid]) + value.to_bytes(n, "big")


def steady_ecu(**options: Any) -> ObdEcu:
    return ObdEcu(np.zeros(1), {name: np.array([x]) for name, x in STEADY.items()}, **options)


@contextmanager
def answering(ecu: ObdEcu, channel: str, interface: str = "virtual") -> Iterator[None]:
    """Let the ECU answer on a bus in real time."""

    def answer(over: threading.Event) -> None:
        with can.Bus(interface=interface, channel=channel) as bus:
            while not over.is_set():
                message = bus.recv(0.02)
                for data in ecu.push(message, time.monotonic()) if message else ():
                    bus.send(can.Message(arbitration_id=0x7E8, is_extended_id=False, data=data))

    with beside(answer):
        yield


class SimulatedBus(can.BusABC):
    """A bus with the ECU on it; time passes only while somebody waits.

    until_s : then ``stop`` is called
    """

    def __init__(self, ecu: ObdEcu, *, until_s: float = math.inf, seed: int = 1) -> None:
        super().__init__(channel="simulated")
        self.channel_info = "simulated"
        self.ecu, self._until_s, self.loss = ecu, until_s, 0.0
        self.now_s = 0.0
        self.stop: Callable[[], None] = lambda: None
        self.sent: list[tuple[float, can.Message]] = []
        self._coming: list[tuple[float, int, int, bytes, bool]] = []
        self._n = 0
        self._rng = np.random.default_rng(seed)

    def put(self, at_s: float, can_id: int, data: bytes, *, extended: bool = False) -> None:
        self._n += 1
        heapq.heappush(self._coming, (at_s, self._n, can_id, data, extended))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append((self.now_s, msg))
        is_request = msg.data[0] >> 4 == 0
        at_s = self.now_s + (self._rng.uniform(0.02, 0.04) if is_request else 1e-3)
        if self.loss and self._rng.random() < self.loss:
            return
        for data in self.ecu.push(msg, self.now_s):
            if not self.loss or self._rng.random() >= self.loss:
                self.put(at_s, self.ecu.response, data, extended=self.ecu.is_extended)
            at_s += 5e-4

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message, _ = self._recv_internal(timeout)
        return message

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end_s = self.now_s + (timeout or 0.0)
        if self.now_s >= self._until_s:
            self.stop()
        if not self._coming or self._coming[0][0] > end_s:
            self.now_s = max(end_s, self.now_s + 1e-6)
            return None, False
        at_s, _, can_id, data, extended = heapq.heappop(self._coming)
        self.now_s = max(self.now_s, at_s)
        message = can.Message(
            timestamp=1_700_000_000 + self.now_s,
            arbitration_id=can_id,
            is_extended_id=extended,
            data=data,
        )
        return message, False


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
