"""Who answers testers by which options, and a real tester, udsoncan, on one virtual bus."""

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

from monitor.base import config
from monitor.base.command_line import signature
from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import Frame
from monitor.bus.diagnostics.server import Diagnostics, answer
from monitor.bus.diagnostics.state import State
from monitor.bus.link.recorder import message_of
from monitor.bus.loop import Loop
from monitor.cli import diagnostics, main
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.store import Memory
from monitor.pipeline import replay
from tests.helpers.bus.beside import beside, until
from tests.helpers.bus.diagnostics_state import VIN
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
SETUP = replay.set_up(None, [], config.load())


class Ecu:
    """Sends every message of ``o2_ecu.dbc``, the engine speed as set."""

    engine_speed_rpm = 0.0

    def send(self, over: threading.Event) -> None:
        with can.Bus(CHANNEL, interface="virtual") as bus:
            for number in count():
                if over.wait(PERIOD_S):
                    return
                values = STANDING | {"engine_speed_rpm": self.engine_speed_rpm}
                for can_id in MESSAGES:
                    data = payload(can_id, values, number)
                    bus.send(message_of(Frame(time.time_ns(), can_id, False, data)))


def attached_to(loop: Loop, *words: str) -> list[Diagnostics]:
    parser = argparse.ArgumentParser()
    signature.add_options(parser, diagnostics.DiagnosticsOptions)
    found = diagnostics.diagnostics(parser.parse_args(words), SETUP, loop)
    assert all(isinstance(each, Diagnostics) for each in found)
    return [each for each in found if isinstance(each, Diagnostics)]


@contextmanager
def answering(path: Path) -> Iterator[State]:
    """Run a loop with a memory, which answers testers; give what it answers from."""
    with can.Bus(CHANNEL, interface="virtual") as bus, closing(Memory(path)) as memory:
        loop = Loop(bus, SETUP, memory=memory, say=lambda _: None)
        (server,) = attached_to(loop, "--transmit")
        loop.attachments.append(server)
        with beside(lambda _: loop.run()):
            try:
                yield server.state
            finally:
                loop.stop()


def states(path: Path) -> dict[str, str]:
    with closing(Memory(path)) as memory:
        return {d.code: d.state for d in memory.load().dtcs if d.state}


def test_clearing_waits_for_the_engine_to_stand_and_is_on_disk_by_the_answer(
    tmp_path: Path,
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
        answering(path) as state,
        beside(ecu.send),
        can.Bus(CHANNEL, interface="virtual", can_filters=ANSWERS) as bus,
    ):
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
            ecu.engine_speed_rpm = 0.0
            assert until(lambda: state.values.get("engine_speed_rpm") == 0.0, READY_S)
            client.change_session(3)
            assert client.clear_dtc().positive
            assert states(path) == {}
            assert client.get_dtc_by_status_mask(0x0C).service_data.dtcs == []


def attached(*words: str, memory: Memory | None = None) -> list[Diagnostics]:
    with can.Bus("options", interface="virtual") as bus:
        loop = Loop(bus, SETUP, memory=memory, say=lambda _: None)
        loop.pipeline.monitor.store.fail("gain_low", 0)
        return attached_to(loop, *words)


def test_nothing_is_answered_unless_transmitting_is_asked_for() -> None:
    assert attached() == []


@pytest.mark.parametrize(
    "words", [("--diagnostics-id", "7EA"), ("--vin", VIN), ("--clear-while-running",)]
)
def test_options_of_diagnostics_need_transmitting(words: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="only with --transmit"):
        attached(*words)
    if words[0] != "--diagnostics-id":
        with pytest.raises(UsageError, match="not with --diagnostics-id none"):
            attached("--transmit", "--diagnostics-id", "none", *words)


@pytest.mark.parametrize("option", ["--obd-request=7E0", "--obd-rate=5", "--sink-rate=2"])
def test_an_option_without_the_one_that_it_belongs_to_is_refused(option: str) -> None:
    assert main(["run", "-i", "virtual", "-c", "q", "--duration", "0.1", option]) == 2


def test_with_transmit_the_monitor_answers_as_the_second_control_unit() -> None:
    (server,) = attached("--transmit")
    assert set(server.identifiers) == {(0x7DF, False), (0x7E1, False)}
    assert server.state.identity.vin is None
    assert server.state.identity.model_sha256 == SETUP.model.sha256
    assert "engine_speed_rpm" in server.state.names
    assert not server.state.clear_while_running


def test_the_engines_own_identifier_and_a_wrong_vin_are_refused() -> None:
    with pytest.raises(UsageError, match="7E8 is the engine's"):
        attached("--transmit", "--diagnostics-id", "7E8")
    with pytest.raises(UsageError, match="wanted 17"):
        attached("--transmit", "--vin", "SHORT")


def test_without_can_isotp_transmitting_goes_on_and_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(diagnostics, "find_spec", lambda _: None)
    assert attached("--transmit") == []
    assert "pip install '.[diagnostics]'" in capsys.readouterr().out
    with pytest.raises(UsageError, match="can-isotp is not installed"):
        attached("--transmit", "--diagnostics-id", "7E9")


def test_a_clearing_that_a_full_disk_does_not_take_is_not_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(saved: Saved) -> None:
        raise RecordingError("disk full")

    with closing(Memory(tmp_path / "o2")) as memory:
        (server,) = attached("--transmit", "--clear-while-running", memory=memory)
        monkeypatch.setattr(memory, "save", full)
        assert answer(b"\x04", False, server.state) == b"\x7f\x04\x22"
