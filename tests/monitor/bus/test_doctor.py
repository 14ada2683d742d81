"""What ``o2mon doctor`` says of spoilt buses, and what it advises."""

import json
import re
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import can
import pytest

import dbc
from monitor.base.types import Frame
from monitor.bus.bench.findings import BusFinding, of_bus, of_interface
from monitor.bus.bench.interface import Interface
from monitor.bus.link.error_frames import error_frame
from monitor.bus.link.port import BusHealth
from monitor.cli import main
from monitor.decode.bus_map import BusMap
from monitor.frames.blocks import block_of
from monitor.pipeline.replay import shipped_model
from tests.helpers.bus.beside import beside, send_as_driven
from tests.helpers.logs.bus_maps import OWN, RUSEFI, ecu

FOREIGN = [Frame(k * 20_000_000, 0x123, False, bytes([k % 256, 1])) for k in range(150)]
REAL = Interface("can0", "can", True, 500_000, "0.875", True, "error-active")


def identifier(message: str, bus_map: BusMap = OWN) -> int:
    channels = bus_map.channels.values()
    return next(c.message.frame_id for c in channels if c.message.name == message)


@pytest.fixture
def doctor(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Give the doctor, who listens while a script is played into a virtual bus in real time."""
    channel = f"doctor {time.monotonic_ns()}"

    def run(script: Iterable[Frame | can.Message], *options: str) -> tuple[int, str]:
        def play(over: threading.Event) -> None:
            with can.Bus(channel, interface="virtual") as bus:
                send_as_driven(bus, script, over)

        with beside(play):
            call = ["doctor", "-i", "virtual", "-c", channel, "--seconds", "0.8", *options]
            code = main(call)
        return code, capsys.readouterr().out

    return run


Doctor = Callable[..., tuple[int, str]]


def test_nothing_is_wrong_with_a_sound_bus(doctor: Doctor) -> None:
    code, said = doctor(ecu())
    assert code == 0, said
    assert said.endswith("nothing wrong was found\n")
    assert said.count("as wanted") == len({c.message for c in OWN.channels.values()}), said


FUEL, LAMBDA = identifier("ECU_Fuel"), identifier("ECU_Lambda")
SPOILT: dict[str, tuple[list[Frame], list[str]]] = {
    "without frames": ([], ["1. Nothing was received.", "same interface and channel"]),
    "with foreign frames alone": (
        FOREIGN,
        ["No frame on this bus is of o2_ecu.dbc (the project's own ECU", "1 identifier: 123"],
    ),
    "without a message": (
        [f for f in ecu() if f.can_id != FUEL],
        ["1. ECU_Fuel (0C1) never came, so these are missing: fuel_mass_mg, rail"],
    ),
    "with a message of 29 bits in place of 11": (
        [f._replace(is_extended=f.can_id == FUEL) for f in ecu()],
        ["1. ECU_Fuel (0C1) comes with 29 bits of identifier"],
    ),
    "with a message at a quarter of its rate": (
        [*[f for f in ecu() if f.can_id == LAMBDA][::4], *(f for f in ecu() if f.can_id != LAMBDA)],
        ["1. ECU_Lambda (0C2) comes 1", "times per second, 50 are wanted"],
    ),
}


@pytest.mark.parametrize("bus", SPOILT)
def test_a_spoilt_bus_is_told_with_its_cause_and_nothing_else(doctor: Doctor, bus: str) -> None:
    script, words = SPOILT[bus]
    code, said = doctor(script)
    assert code == 3
    assert [each for each in words if each not in said] == [], said
    assert "2. " not in said


def test_a_bus_that_falls_silent_is_told_as_such_and_not_as_slow(doctor: Doctor) -> None:
    _, said = doctor(ecu()[:100], "--seconds", "1.8")
    assert "1. The bus fell silent 1." in said and "2. " not in said


def test_a_map_lacks_only_what_neither_its_messages_nor_its_derived_signals_provide(
    doctor: Doctor, tmp_path: Path
) -> None:
    # GIVEN rusEFI without the message from which the fuel per stroke is derived, and two maps
    lacking, text = identifier("BASE6", RUSEFI), dbc.path("rusefi.toml").read_text()
    frames = [f for f in ecu(RUSEFI) if f.can_id != lacking]
    part = tmp_path / "part.toml"
    part.write_text("".join(line for line in text.splitlines(True) if "FpHigh" not in line))
    options = ["--dbc", str(dbc.path("rusefi.dbc")), "--model", str(shipped_model()), "--map"]
    whole, lacks = (doctor(frames, *options, str(m))[1] for m in (dbc.path("rusefi.toml"), part))
    # THEN the message is at fault, and the map only where it is
    assert f"1. BASE6 ({lacking:03X}) never came" in whole
    assert "The map provides" not in whole
    assert "The map provides no rail_pressure_mpa, which shipped.onnx needs." in lacks


def test_answers_of_an_engine_with_29_bit_diagnostics_are_those_that_a_run_reads(
    doctor: Doctor,
) -> None:
    # GIVEN an engine that answers OBD requests as 18DAF110
    speed = bytes.fromhex("04410C1AF8000000")
    frames = [Frame(i * 20_000_000, 0x18DAF110, True, speed) for i in range(40)]
    options = [f"--dbc={dbc.path('obd2.dbc')}", f"--map={dbc.path('obd2.toml')}"]
    _, said = doctor(frames, *options)
    assert "No frame on this bus" not in said
    assert re.search(r"7E8 +\d\d", said), said


@pytest.mark.parametrize("counts", [True, False], ids=["with a counter", "without one"])
def test_two_senders_of_one_message_are_told_from_a_fast_one(
    doctor: Doctor, counts: bool, tmp_path: Path
) -> None:
    # GIVEN a second ECU that sends ECU_Lambda 7 ms after the first, with another lambda
    bare, text = tmp_path / "bare.toml", dbc.path("o2_ecu.toml").read_text()
    bare.write_text(text[text.index("[signals]") :])
    options = [] if counts else ["--dbc", str(dbc.path("o2_ecu.dbc")), "--map", str(bare)]
    other = [f for f in ecu(lambda_measured=1.3) if f.can_id == LAMBDA]
    again = [f._replace(t_ns=f.t_ns + 7_000_000) for f in other]
    # WHEN the doctor listens THEN there are two senders, and the rate is no finding of its own
    code, said = doctor([*ecu(), *again[3:]], *options)
    assert code == 3
    assert "ECU_Lambda (0C2) comes from two senders in turn, " in said
    assert "2. " not in said, said


def test_errors_among_frames_and_errors_alone_have_different_causes(doctor: Doctor) -> None:
    errors = [can.Message(timestamp=k * 0.05, is_error_frame=True) for k in range(40)]
    _, alone = doctor(errors)
    _, among = doctor([*ecu(), *errors])
    assert "Only errors came: 1" in alone and "rate is wrong: try another bit rate" in alone
    assert "error frames came among" in among and "terminating resistor" in among


def test_a_wrong_length_and_a_cold_sensor_are_told(doctor: Doctor) -> None:
    cold = ecu(lambda_measured=float("nan"))
    _, said = doctor([f._replace(data=f.data[: 6 if f.can_id == FUEL else 8]) for f in cold])
    assert "ECU_Fuel (0C1) has 6 bytes, the database says 8." in said
    assert "lambda_measured: the ECU marks it as not available" in said


def test_a_frame_that_nobody_acknowledges_is_told() -> None:
    # GIVEN one node that is error passive: listen-only, its frame comes again and again
    again = block_of([Frame(k * 250_000, 0xC0, False, b"\1\2") for k in range(400)])
    assert names(of_bus(again, BusHealth(), REAL)) == ["no_acknowledgement"]
    # the same at 100 frames per second is no endless frame
    calm = again._replace(t_ns=again.t_ns * 40)
    assert names(of_bus(calm, BusHealth(), REAL)) == []
    # an error frame of the kernel that names the place of the acknowledgement says it, too
    assert error_frame(0x008, bytes([0, 0, 0, 0x19, 0, 0, 0, 0])).no_acknowledge
    assert not error_frame(0x008, bytes([0, 0, 0, 0x0A, 0, 0, 0, 0])).no_acknowledge


def names(findings: Iterable[BusFinding]) -> list[str]:
    found = list(findings)
    assert all(line and "{" not in line for each in found for line in each.lines)
    return [each.name for each in found]


def test_an_interface_that_is_down_or_off_needs_no_frame_to_be_told() -> None:
    (down,) = of_interface(replace(REAL, is_up=False, bitrate=None))
    assert down.lines[1] == "sudo ip link set can0 up type can bitrate 500000 listen-only on"
    assert names(of_interface(replace(REAL, state="bus-off"))) == ["interface_off"]
    assert names(of_interface(REAL)) == []


IP = """#!/usr/bin/env python3
import json, pathlib, sys
state = pathlib.Path(__file__).with_name("state.json")
link, words = json.loads(state.read_text()), sys.argv[1:]
if "show" in words:
    if words[-1] != "can0":
        sys.exit('Device "%s" does not exist.' % words[-1])
    print(json.dumps([link]))
elif "type" in words:
    link["linkinfo"]["info_data"]["bittiming"]["bitrate"] = int(words[words.index("bitrate") + 1])
    link["linkinfo"]["info_data"]["ctrlmode"] = ["LISTEN-ONLY"] * (words[-1] == "on")
else:
    link["flags"] = ["UP"] * (words[-1] == "up")
state.write_text(json.dumps(link))
"""


@pytest.fixture
def can0(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A stand-in of ip(8) with the interface can0, as iproute2 6.1 prints it; give its state."""
    program, state = tmp_path / "ip", tmp_path / "state.json"
    program.write_text(IP)
    program.chmod(0o755)
    info = {"state": "ERROR-ACTIVE", "berr_counter": {"tx": 0, "rx": 12}, "ctrlmode": []}
    info["bittiming"] = {"bitrate": 500000, "sample_point": "0.875"}
    linkinfo = {"info_kind": "can", "info_data": info, "info_xstats": {"bus_error": 7}}
    state.write_text(json.dumps({"ifname": "can0", "flags": ["UP"], "linkinfo": linkinfo}))
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    return state


class RatedBus(can.BusABC):
    """Gives frames if the interface has the rate of the bus, otherwise error frames."""

    def __init__(self, state: Path, bitrate: int) -> None:
        super().__init__(channel="can0")
        self.channel_info = "rated bus"
        timing = json.loads(state.read_text())["linkinfo"]["info_data"]["bittiming"]
        self.is_right = timing["bitrate"] == bitrate

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        time.sleep(0.001)
        return can.Message(arbitration_id=0x123, is_error_frame=not self.is_right), False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("the doctor sends nothing")


def test_a_scan_finds_the_bit_rate_and_puts_the_interface_back(
    can0: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN can0 at 500 kbit/s in normal mode on a bus of 250 kbit/s
    before = json.loads(can0.read_text())
    monkeypatch.setattr("monitor.cli.check.open_bus", lambda _: RatedBus(can0, 250_000))
    monkeypatch.setattr("monitor.cli.doctor.SCAN_S", 0.1)
    # WHEN it is scanned THEN the rate is named, and the interface is as before
    assert main(["doctor", "-i", "socketcan", "-c", "can0", "--scan"]) == 3
    said = capsys.readouterr().out
    assert "500 kbit/s, normal mode, error-active, rx 12, bus error 7" in said
    assert "The bus runs at 250 kbit/s, can0 is set to another rate." in said
    assert "type can bitrate 250000 listen-only on" in said
    assert json.loads(can0.read_text()) == before


def test_what_cannot_be_asked_is_said(can0: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "-i", "virtual", "-c", "x", "--scan"]) == 2
    assert main(["doctor", "-i", "socketcan", "-c", "can7"]) == 2
    assert main(["doctor", "--seconds", "1"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert "--scan needs a SocketCAN interface with a bit rate" in said[0]
    assert "no interface can7" in said[1]
    assert "give a LOG, or a bus" in said[2]
