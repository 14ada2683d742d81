"""A real tester, udsoncan, and a live loop with its fault memory on one virtual bus."""

import argparse
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import count
from pathlib import Path
from typing import Final

import can
import isotp
import pytest
import udsoncan
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection
from udsoncan.exceptions import NegativeResponseException

from monitor.base.command_line import signature
from monitor.base.types import Frame
from monitor.bus.diagnostics.server import Diagnostics
from monitor.bus.diagnostics.state import State
from monitor.bus.link.recorder import message_of
from monitor.bus.loop import Loop
from monitor.cli.diagnostics import DiagnosticsOptions, diagnostics
from monitor.memory.dtc_store import DtcStore
from monitor.memory.store import Memory
from monitor.pipeline import replay
from tests.helpers.bus.beside import beside
from tests.helpers.bus.live_player import until
from tests.helpers.logs.batch_logs import MESSAGES, USUAL, payload
from tests.helpers.logs.bus_maps import OWN as ECU_MAP

PERIOD_S: Final = 0.05
CHANNEL: Final = "diagnostics"
MOVING: Final = ("closed_loop", "engine_torque_nm", "throttle_percent", "vehicle_speed_km_h")
STANDING: Final = dict.fromkeys(ECU_MAP.channels, 0.0) | {
    k: x for k, x in USUAL.items() if k not in MOVING
}
ANSWERS: Final = [{"can_id": 0x7E9, "can_mask": 0x7FF}]
ADDRESS: Final = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E1, rxid=0x7E9)
UDS_CONFIG = udsoncan.configs.default_client_config | {
    "request_timeout": 5.0,
    "p2_timeout": 2.0,
    "use_server_timing": False,  # a machine that runs other tests, too, may need more than 50 ms
}
SLOW = 0x013300
READY_S = 30.0


class Ecu:
    """Sends every message of ``o2_ecu.dbc``, the engine speed as set."""

    engine_speed_rpm = 0.0

    def send(self, over: threading.Event) -> None:
        """Send until it is over."""
        with can.Bus(CHANNEL, interface="virtual") as bus:
            for number in count():
                if over.wait(PERIOD_S):
                    return
                values = STANDING | {"engine_speed_rpm": self.engine_speed_rpm}
                for can_id in MESSAGES:
                    data = payload(can_id, values, number)
                    bus.send(message_of(Frame(time.time_ns(), can_id, False, data)))


@contextmanager
def answering(setup: replay.Setup, path: Path) -> Iterator[State]:
    """Run a loop with a memory, which answers testers; give what it answers from."""
    parser = argparse.ArgumentParser()
    signature.add_options(parser, DiagnosticsOptions)
    with can.Bus(CHANNEL, interface="virtual") as bus, closing(Memory(path)) as memory:
        loop = Loop(bus, setup, memory=memory, say=lambda _: None)
        (server,) = diagnostics(parser.parse_args(["--transmit"]), setup, loop)
        assert isinstance(server, Diagnostics)
        loop.attachments.append(server)
        with beside(lambda _: loop.run()):
            try:
                yield server.state
            finally:
                loop.stop()


def states(path: Path) -> dict[str, str]:
    """Return the codes on disk that are pending or confirmed."""
    with closing(Memory(path)) as memory:
        return {d.code: d.state for d in memory.load().dtcs if d.state}


def test_clearing_waits_for_the_engine_to_stand_and_is_on_disk_by_the_answer(
    setup: replay.Setup, tmp_path: Path
) -> None:
    # GIVEN a slow sensor, confirmed in its second driving cycle, and a code that is pending
    path, store, ecu = tmp_path / "o2.db", DtcStore(), Ecu()
    for _ in range(2):
        store.start_driving_cycle()
        store.fail("slow_symmetric", 5)
    store.fail("biased_lean", 6)
    with closing(Memory(path)) as memory:
        memory.save(store.saved)
    with (
        answering(setup, path) as state,
        beside(ecu.send),
        can.Bus(CHANNEL, interface="virtual", can_filters=ANSWERS) as bus,
    ):
        # WHEN the engine runs
        ecu.engine_speed_rpm = 800.0
        assert until(lambda: state.values.get("engine_speed_rpm") == 800.0, READY_S)
        # THEN who asks all control units hears of lamp and code
        bus.send(can.Message(arbitration_id=0x7DF, is_extended_id=False, data=b"\2\1\1"))
        answered = bus.recv(READY_S)
        assert answered is not None
        assert answered.data[:7].hex() == "06410181042020"
        # AND the codes are told, and are not cleared
        connection = PythonIsoTpConnection(isotp.CanStack(bus, address=ADDRESS))
        with Client(connection, config=UDS_CONFIG) as client:
            (slow,) = client.get_dtc_by_status_mask(0x08).service_data.dtcs
            assert (slow.id, slow.status.warning_indicator_requested) == (SLOW, True)
            client.change_session(3)
            with pytest.raises(NegativeResponseException) as refusal:
                client.clear_dtc()
            assert refusal.value.response.code == 0x22
            assert states(path) == {"P0133": "confirmed", "P2195": "pending"}
            # WHEN it stands
            ecu.engine_speed_rpm = 0.0
            assert until(lambda: state.values.get("engine_speed_rpm") == 0.0, READY_S)
            client.change_session(3)
            assert client.clear_dtc().positive
            assert states(path) == {}
            assert client.get_dtc_by_status_mask(0x0C).service_data.dtcs == []
