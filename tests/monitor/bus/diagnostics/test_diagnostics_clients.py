"""Real scan tools against the monitor: udsoncan, and python-OBD through an adapter.

Both reach a live loop on a virtual bus; the codes come from a fault memory on disk.
"""

import argparse
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Final

import can
import isotp
import obd
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
from monitor.memory import obd_records
from monitor.memory.dtc_store import DtcStore
from monitor.memory.store import Memory
from monitor.pipeline import replay
from tests.helpers.bus.diagnostics_state import VIN
from tests.helpers.bus.elm327 import terminal_of
from tests.helpers.bus.live_player import until
from tests.helpers.logs.batch_logs import MESSAGES, USUAL, payload
from tests.helpers.logs.bus_maps import OWN as ECU_MAP

PERIOD_S: Final = 0.05
CHANNEL: Final = "diagnostics"
MOVING: Final = ("closed_loop", "engine_torque_nm", "throttle_percent", "vehicle_speed_km_h")
STANDING: Final = dict.fromkeys(ECU_MAP.channels, 0.0) | {
    k: x for k, x in USUAL.items() if k not in MOVING
}


class Ecu:
    """Sends every message of ``o2_ecu.dbc``, the engine speed as set."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self.engine_speed_rpm = bus, 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """Fall silent."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        count = 0
        while not self._stop.wait(PERIOD_S):
            count += 1
            values = STANDING | {"engine_speed_rpm": self.engine_speed_rpm}
            for can_id in MESSAGES:
                data = payload(can_id, values, count)
                self._bus.send(message_of(Frame(time.time_ns(), can_id, False, data)))


SLOW = 0x013300
READY_S = 30.0


def write_memory(path: Path) -> None:
    """Store a slow sensor, confirmed in its second driving cycle, and a code that is pending."""
    store = DtcStore()
    for _ in range(2):
        store.start_driving_cycle()
        store.fail("slow_symmetric", 5)
    store.fail("biased_lean", 6)
    store.report(
        [obd_records.TestResult("response", "lag_rich_to_lean_s", 0.31, float("-inf"), 0.25)]
    )
    with closing(Memory(path)) as memory:
        memory.save(store.saved)


def states(path: Path) -> dict[str, str]:
    """Return the codes on disk that are pending or confirmed."""
    with closing(Memory(path)) as memory:
        return {d.code: d.state for d in memory.load().dtcs if d.state}


UDS_CONFIG = udsoncan.configs.default_client_config | {
    "request_timeout": 5.0,
    "p2_timeout": 2.0,
    "use_server_timing": False,  # a machine that runs other tests, too, may need more than 50 ms
}


class Bench:
    """A monitor, an ECU and a scan tool on one bus."""

    def __init__(self, state: State, tool: obd.OBD, ecu: Ecu, memory: Path) -> None:
        self._state, self.tool, self.ecu, self.memory = state, tool, ecu, memory

    def drive(self, engine_speed_rpm: float) -> None:
        """Set the engine speed and wait until the monitor has seen it."""
        self.ecu.engine_speed_rpm = engine_speed_rpm
        assert until(
            lambda: self._state.values.get("engine_speed_rpm") == engine_speed_rpm, READY_S
        )


@pytest.fixture(scope="module")
def bench(setup: replay.Setup, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    path = tmp_path_factory.mktemp("memory") / "o2.db"
    write_memory(path)
    parser = argparse.ArgumentParser()
    signature.add_options(parser, DiagnosticsOptions)
    args = parser.parse_args(["--transmit", "--vin", VIN])
    with ExitStack() as stack:
        buses = [stack.enter_context(can.Bus(CHANNEL, interface="virtual")) for _ in range(3)]
        started, loops = threading.Event(), []

        def run() -> None:
            with closing(Memory(path)) as memory:
                loop = Loop(buses[0], setup, memory=memory, say=lambda _: None)
                loop.attachments.extend(diagnostics(args, setup, loop))
                loops.append(loop)
                started.set()
                loop.run()

        thread = threading.Thread(target=run)
        thread.start()
        assert started.wait(READY_S)
        stack.callback(thread.join)
        stack.callback(loops[0].stop)
        ecu = stack.enter_context(closing(Ecu(buses[1])))
        (answering,) = loops[0].attachments
        assert isinstance(answering, Diagnostics)
        tool = stack.enter_context(closing(obd.OBD(terminal_of(buses[2]), fast=False)))
        yield Bench(answering.state, tool, ecu, path)


@pytest.fixture
def client(bench: Bench) -> Iterator[Client]:
    """A tester of UDS on the identifiers of the scan tool, so only one of them speaks."""
    filters = [{"can_id": 0x7E9, "can_mask": 0x7FF}]
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E1, rxid=0x7E9)
    with can.Bus(CHANNEL, interface="virtual", can_filters=filters) as bus:
        layer = isotp.CanStack(bus, address=address)
        with Client(PythonIsoTpConnection(layer), config=UDS_CONFIG) as opened:
            yield opened


def test_a_scan_tool_finds_what_the_monitor_supports_and_who_it_is(bench: Bench) -> None:
    tool = bench.tool
    assert tool.status() == obd.OBDStatus.CAR_CONNECTED
    names = {command.name for command in tool.supported_commands}
    assert {"STATUS", "STATUS_DRIVE_CYCLE", "MONITOR_O2_B1S1", "VIN", "CVN"} <= names
    assert "RPM" not in names  # the engine's own control unit tells that
    assert tool.query(obd.commands.OBD_COMPLIANCE).value == "OBD-II as defined by the CARB"
    assert tool.query(obd.commands.VIN).value.decode() == VIN
    sha256 = replay.sha256_of(replay.shipped_model())
    # python-OBD cuts the text short by one, and takes some figures for padding
    found = tool.query(obd.commands.CALIBRATION_ID).value.decode()
    assert len(found) > len("shipped-")
    assert f"shipped-{sha256[:8]}".startswith(found)


def test_a_scan_tool_reads_lamp_readiness_codes_and_results(bench: Bench) -> None:
    tool = bench.tool
    status = tool.query(obd.commands.STATUS).value
    assert (status.MIL, status.DTC_count, status.ignition_type) == (True, 1, "spark")
    assert status.OXYGEN_SENSOR_MONITORING.available
    assert not status.OXYGEN_SENSOR_MONITORING.complete
    ((code, words),) = tool.query(obd.commands.GET_DTC).value
    assert code == "P0133"
    assert "O2 Sensor Circuit Slow" in words
    assert {code for code, _ in tool.query(obd.commands.GET_CURRENT_DTC).value} == {code, "P2195"}
    results = {t.tid: t for t in tool.query(obd.commands.MONITOR_O2_B1S1).value.tests}
    assert results[0x80].value.to("ms").magnitude == 310
    assert results[0x80].max.to("ms").magnitude == 250


def test_clearing_waits_for_the_engine_to_stand_and_is_on_disk_by_the_answer(
    bench: Bench, client: Client
) -> None:
    bench.drive(800.0)
    (slow,) = client.get_dtc_by_status_mask(0x08).service_data.dtcs
    assert (slow.id, slow.status.warning_indicator_requested) == (SLOW, True)
    bench.tool.query(obd.commands.CLEAR_DTC)
    client.change_session(3)
    with pytest.raises(NegativeResponseException) as refusal:
        client.clear_dtc()
    assert refusal.value.response.code == 0x22
    assert states(bench.memory) == {"P0133": "confirmed", "P2195": "pending"}
    bench.drive(0.0)
    client.change_session(3)
    assert client.clear_dtc().positive
    assert states(bench.memory) == {}
    assert client.get_dtc_by_status_mask(0x0C).service_data.dtcs == []
