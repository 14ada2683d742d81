"""An engine's control unit that broadcasts on a python-can bus, in a thread of the test."""

import threading
import time
from types import TracebackType
from typing import Final, Self

import can

import dbc
from monitor.decode.bus_map import load_pairs
from monitor.decode.checksum import payload_checksum
from tests.helpers.batch_logs import USUAL

PERIOD_S: Final = 0.05
CHECKSUM_BYTE: Final = 7
CHANGING: Final = ("closed_loop", "engine_speed_rpm", "engine_torque_nm", "throttle_percent")
MOVING: Final = ("vehicle_speed_km_h", "purge_duty_percent", "sensor_heater_percent")
VALUES: Final = {name: x for name, x in USUAL.items() if name not in (*CHANGING, *MOVING)}


class Ecu:
    """Sends every message of ``o2_ecu.dbc`` with counter and checksum, the engine speed as set."""

    def __init__(self, bus: can.BusABC, engine_speed_rpm: float) -> None:
        bus_map = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])
        self._channels = list(bus_map.channels.values())
        self._messages = {c.message.frame_id: c.message for c in self._channels}
        self._bus, self.engine_speed_rpm = bus, engine_speed_rpm
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        counter = 0
        while not self._stop.wait(PERIOD_S):
            values = VALUES | {"engine_speed_rpm": self.engine_speed_rpm}
            for message in self._messages.values():
                fields = {s.name: 0.0 for s in message.signals} | {"AliveCounter": counter % 16}
                for channel in self._channels:
                    if channel.message is message:
                        value = values.get(channel.mapped.name, 0.0)
                        fields[channel.signal.name] = value
                payload = bytearray(message.encode(fields, strict=False))
                payload[CHECKSUM_BYTE] = payload_checksum(
                    "crc8_sae_j1850_id", message.frame_id, bytes(payload), CHECKSUM_BYTE
                )
                self._bus.send(
                    can.Message(
                        timestamp=time.time(),
                        arbitration_id=message.frame_id,
                        is_extended_id=False,
                        data=payload,
                    )
                )
            counter += 1
