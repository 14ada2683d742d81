"""Real scan tools against the monitor: udsoncan in this process, python-OBD through an adapter.

Both reach a live loop on a bus; the codes come from a fault memory on disk.
"""

import argparse
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import can
import isotp
import obd
import pytest
import udsoncan
from obd.protocols import ECU
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection
from udsoncan.exceptions import NegativeResponseException

import dbc
from monitor.base import config
from monitor.base.command_line import signature
from monitor.bus.loop import Loop
from monitor.cli.diagnostics import DiagnosticsOptions, diagnostics
from monitor.decode.bus_map import load_pairs
from monitor.decode.checksum import payload_checksum
from monitor.memory import obd_records
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.store import Memory
from monitor.pipeline import replay
from tests.conftest import ROOT
from tests.helpers.bus.diagnostics_state import VIN
from tests.helpers.logs.batch_logs import USUAL

ELM327: Final = ROOT / "tests/helpers/bus/obd_clients/elm327.py"
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


SLOW = 0x013300
READY_S = 30.0


def write_memory(path: Path) -> None:
    """Store a slow sensor, confirmed in its second driving cycle, and a code that is pending."""
    store = DtcStore()
    for _ in range(2):
        store.start_driving_cycle()
        store.fail("slow_symmetric", 5)
    store.fail("biased_lean", 6)
    store.freeze(
        FreezeFrame("P0133", 5, {"engine_speed_rpm": 2000.0, "coolant_temperature_degc": 90.0})
    )
    store.report(
        [obd_records.TestResult("response", "lag_rich_to_lean_s", 0.31, float("-inf"), 0.25)]
    )
    with closing(Memory(path)) as memory:
        memory.save(store.saved)


def states(path: Path) -> dict[str, str]:
    """Return the codes on disk that are pending or confirmed."""
    with closing(Memory(path)) as memory:
        return {d.code: d.state for d in memory.load().dtcs if d.state}


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Wait until a condition holds."""
    until_s = time.monotonic() + READY_S
    while not condition():
        assert time.monotonic() < until_s, f"not within {READY_S} s: {what}"
        time.sleep(0.05)


# udsoncan, can-isotp, python-can's virtual bus; the loop in another thread


class Raw(udsoncan.DidCodec):
    """Leaves data as they are."""

    def __init__(self, length: int) -> None:
        self._length = length

    def decode(self, data: bytes) -> bytes:
        return data

    def __len__(self) -> int:
        return self._length


UDS_CONFIG = udsoncan.configs.default_client_config | {
    "request_timeout": 5.0,
    "p2_timeout": 2.0,
    "use_server_timing": False,  # a machine that runs other tests, too, may need more than 50 ms
    "data_identifiers": {
        0xF190: udsoncan.AsciiCodec(17),
        0xF405: Raw(1),
        0xF40C: Raw(2),
        0xFD00: Raw(32),
        0xFD02: Raw(4),
        0xFD09: Raw(8),
    },
}


class Bench:
    """A monitor, an ECU and a tester on one bus."""

    def __init__(self, client: Client, ecu: Ecu, memory: Path, setup: replay.Setup) -> None:
        self.client, self.ecu, self.memory, self.setup = client, ecu, memory, setup

    def drive(self, engine_speed_rpm: float) -> None:
        """Set the engine speed and wait until the monitor has seen it."""
        self.ecu.engine_speed_rpm = engine_speed_rpm
        wait_for(lambda: self._speed_rpm() == engine_speed_rpm, "engine speed")

    def _speed_rpm(self) -> float:
        response = self.client.tester_present()  # alive before the first sample, too
        assert response.positive
        try:
            raw = self.read(0xFD02) and self.read(0xF40C)
        except NegativeResponseException:
            return -1.0
        return struct.unpack(">H", raw)[0] / 4

    def read(self, identifier: int) -> bytes:
        """Read one data identifier."""
        values = self.client.read_data_by_identifier(identifier).service_data.values
        found = values[identifier]
        assert isinstance(found, bytes | str)
        return found.encode() if isinstance(found, str) else found


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    path = tmp_path_factory.mktemp("memory") / "o2.db"
    write_memory(path)
    setup = replay.set_up(None, [], config.load())
    parser = argparse.ArgumentParser()
    signature.add_options(parser, DiagnosticsOptions)
    args = parser.parse_args(["--transmit", "--vin", VIN, "--diagnostics-id", "18DAF1A5"])
    address = isotp.Address(
        isotp.AddressingMode.NormalFixed_29bits, source_address=0xF1, target_address=0xA5
    )
    channel = "diagnostics"
    with ExitStack() as stack:
        buses = [stack.enter_context(can.Bus(channel, interface="virtual")) for _ in range(3)]
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
        ecu = stack.enter_context(Ecu(buses[1], engine_speed_rpm=0.0))
        buses[2].set_filters([{"can_id": address.get_rx_arbitration_id(), "can_mask": 0x1FFFFFFF}])
        layer = isotp.CanStack(buses[2], address=address)
        client = stack.enter_context(Client(PythonIsoTpConnection(layer), config=UDS_CONFIG))
        yield Bench(client, ecu, path, setup)


def test_a_uds_tester_reads_codes_with_their_status(bench: Bench) -> None:
    confirmed = bench.client.get_dtc_by_status_mask(0x08).service_data
    assert [dtc.id for dtc in confirmed.dtcs] == [SLOW]
    assert confirmed.dtcs[0].status.confirmed
    assert confirmed.dtcs[0].status.warning_indicator_requested
    assert bench.client.get_number_of_dtc_by_status_mask(0x0C).service_data.dtc_count == 2
    supported = bench.client.get_supported_dtc().service_data.dtcs
    assert len(supported) == len(DtcStore().all)


def test_a_uds_tester_reads_snapshot_and_extended_data(bench: Bench) -> None:
    snapshot = bench.client.get_dtc_snapshot_by_dtc_number(SLOW, 1).service_data
    values = {s.did: s.data for s in snapshot.dtcs[0].snapshots}
    assert values == {0xF405: bytes((130,)), 0xF40C: bytes.fromhex("1f40")}
    occurrence = bench.client.get_dtc_extended_data_by_dtc_number(SLOW, 1, data_size=1)
    (record,) = occurrence.service_data.dtcs[0].extended_data
    assert record.raw_data == b"\x02"  # it failed in two driving cycles


def test_a_uds_tester_reads_the_monitors_state(bench: Bench) -> None:
    bench.drive(0.0)
    assert bench.read(0xF190).decode() == VIN
    assert bench.read(0xFD00).hex() == bench.setup.model_sha256
    assert struct.unpack(">f", bench.read(0xFD02))[0] == pytest.approx(1.0, abs=1e-3)
    samples, _ = struct.unpack(">II", bench.read(0xFD09))
    assert samples > 0


def test_clearing_waits_for_the_engine_to_stand_and_is_on_disk_by_the_answer(bench: Bench) -> None:
    bench.drive(800.0)
    bench.client.change_session(3)
    with pytest.raises(NegativeResponseException) as refusal:
        bench.client.clear_dtc()
    assert refusal.value.response.code == 0x22
    assert states(bench.memory) == {"P0133": "confirmed", "P2195": "pending"}
    bench.drive(0.0)
    bench.client.change_session(3)
    assert bench.client.clear_dtc().positive
    assert states(bench.memory) == {}
    assert bench.client.get_dtc_by_status_mask(0x0C).service_data.dtcs == []


# python-OBD, an adapter, python-can's udp_multicast; adapter and monitor in processes of their own


GROUP = "239.74.163.9"


@pytest.fixture(scope="module")
def port(worker_id: str = "") -> int:
    return 20000 + (hash((worker_id, time.time_ns())) % 20000)


def start(stack: ExitStack, *command: str) -> "subprocess.Popen[str]":
    """Start a process that ends with the test."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    stack.enter_context(process)
    stack.callback(process.send_signal, signal.SIGTERM)
    return process


@pytest.fixture(scope="module")
def scan_tool(
    tmp_path_factory: pytest.TempPathFactory, port: int
) -> Iterator[tuple[obd.OBD, Ecu, Path]]:
    path = tmp_path_factory.mktemp("memory") / "o2.db"
    write_memory(path)
    bus_options = ("-i", "udp_multicast", "-c", GROUP, "--bus-kwargs", f"port={port}")
    run_options = ("--memory", str(path), "--transmit", "--vin", VIN, "--quiet")
    with ExitStack() as stack:
        bus = stack.enter_context(can.Bus(GROUP, interface="udp_multicast", port=port))
        ecu = stack.enter_context(Ecu(bus, engine_speed_rpm=0.0))
        start(stack, "-m", "monitor.cli", "run", *bus_options, *run_options)
        wait_for(lambda: answers(bus), "the monitor answers")
        adapter = start(stack, str(ELM327), GROUP, str(port))
        assert adapter.stdout
        terminal = adapter.stdout.readline().strip()
        assert re.fullmatch(r"/dev/pts/\d+", terminal)
        tool = obd.OBD(terminal, fast=False)
        stack.callback(tool.close)
        yield tool, ecu, path


def answers(bus: can.BusABC) -> bool:
    """Return whether the monitor answers a request for its bitmap."""
    request = can.Message(arbitration_id=0x7DF, is_extended_id=False, data=b"\x02\x01\x00")
    bus.send(request)
    until_s = time.monotonic() + 0.5
    while time.monotonic() < until_s:
        message = bus.recv(0.1)
        if message is not None and message.arbitration_id == 0x7E9:
            return True
    return False


def test_python_obd_finds_what_the_monitor_supports(
    scan_tool: tuple[obd.OBD, Ecu, Path],
) -> None:
    tool, _, _ = scan_tool
    assert tool.status() == obd.OBDStatus.CAR_CONNECTED
    names = {command.name for command in tool.supported_commands}
    wanted = {"STATUS", "OBD_COMPLIANCE", "STATUS_DRIVE_CYCLE", "MONITOR_O2_B1S1", "VIN", "CVN"}
    assert wanted <= names
    assert "RPM" not in names  # the engine's own control unit tells that


def test_python_obd_reads_lamp_and_readiness(scan_tool: tuple[obd.OBD, Ecu, Path]) -> None:
    tool, _, _ = scan_tool
    status = tool.query(obd.commands.STATUS).value
    assert status.MIL is True
    assert status.DTC_count == 1
    assert status.ignition_type == "spark"
    assert status.OXYGEN_SENSOR_MONITORING.available
    assert not status.OXYGEN_SENSOR_MONITORING.complete
    assert tool.query(obd.commands.OBD_COMPLIANCE).value == "OBD-II as defined by the CARB"


def test_python_obd_reads_codes(scan_tool: tuple[obd.OBD, Ecu, Path]) -> None:
    tool, _, _ = scan_tool
    confirmed = tool.query(obd.commands.GET_DTC).value
    assert [code for code, _ in confirmed] == ["P0133"]
    assert "O2 Sensor Circuit Slow" in confirmed[0][1]
    pending = tool.query(obd.commands.GET_CURRENT_DTC).value
    assert {code for code, _ in pending} == {"P0133", "P2195"}


def test_python_obd_reads_the_freeze_frame(scan_tool: tuple[obd.OBD, Ecu, Path]) -> None:
    # python-OBD leaves the frame's number out, which the standard asks for
    tool, _, _ = scan_tool

    def frame(parameter: int) -> bytes:
        request = f"02{parameter:02X}00".encode()
        command = obd.OBDCommand("", "", request, 0, lambda m: bytes(m[0].data[3:]), ECU.ALL)
        found = tool.query(command, force=True).value
        assert isinstance(found, bytes)
        return found

    assert frame(0x02) == bytes.fromhex("0133")
    assert frame(0x0C) == struct.pack(">H", 4 * 2000)
    assert frame(0x05) == bytes((130,))


def test_python_obd_reads_test_results_in_their_units(
    scan_tool: tuple[obd.OBD, Ecu, Path],
) -> None:
    tool, _, _ = scan_tool
    results = {t.tid: t for t in tool.query(obd.commands.MONITOR_O2_B1S1).value.tests}
    assert results[0x80].value.to("ms").magnitude == 310
    assert results[0x80].max.to("ms").magnitude == 250


def test_python_obd_reads_who_answers(scan_tool: tuple[obd.OBD, Ecu, Path]) -> None:
    tool, _, _ = scan_tool
    assert tool.query(obd.commands.VIN).value.decode() == VIN
    sha256 = replay.sha256_of(replay.shipped_model())
    # python-OBD cuts the text short by one, and takes some figures for padding
    found = tool.query(obd.commands.CALIBRATION_ID).value.decode()
    assert len(found) > len("shipped-")
    assert f"shipped-{sha256[:8]}".startswith(found)


def test_python_obd_clears_only_with_the_engine_off(
    scan_tool: tuple[obd.OBD, Ecu, Path],
) -> None:
    tool, ecu, path = scan_tool

    def cleared() -> bool:
        tool.query(obd.commands.CLEAR_DTC)
        return tool.query(obd.commands.GET_DTC).value == []

    ecu.engine_speed_rpm = 800.0
    time.sleep(1.0)
    assert not cleared()
    assert states(path) == {"P0133": "confirmed", "P2195": "pending"}
    ecu.engine_speed_rpm = 0.0
    wait_for(cleared, "codes cleared")
    assert states(path) == {}
    assert tool.query(obd.commands.STATUS).value.DTC_count == 0
