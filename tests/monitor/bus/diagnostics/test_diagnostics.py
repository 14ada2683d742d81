"""Answers of the OBD services, without a bus."""

import math
import struct
from collections import deque
from typing import Any

import obd
import pytest
from obd.protocols.protocol import Message

from monitor.base.errors import UsageError
from monitor.bus.diagnostics import results
from monitor.bus.diagnostics.state import Identity
from monitor.frames.blocks import block_of
from monitor.memory import obd_records
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline import replay
from monitor.pipeline.frames import FramePipeline
from tests.helpers.bus.diagnostics_state import SHA256, VIN, Vehicle, ask
from tests.helpers.logs.replays import frames_of


def test_a_vehicle_with_a_catalyst_tells_its_readiness_results_and_performance() -> None:
    vehicle = Vehicle()
    store = vehicle.store
    for result in (
        ("catalyst", "capacity_g", 0.06, 0.12, 1.4),
        ("catalyst", "capacity_over_threshold", 0.5, 1.0, 11.67),
        ("downstream", "least_v", 0.08, 0.03, 0.2),
        ("downstream", "lag_rich_to_lean_s", 1.5, 0.0, 0.77),
        ("downstream_heater", "wake_s", 14.0, 0.0, 25.0),
    ):
        store.report([obd_records.TestResult(*result)])
    for test in ("catalyst", "downstream", "downstream_heater", "balance"):
        store.complete(test)
    store.count_judged("catalyst")
    assert ask("01 01", vehicle) == "41 01 81 04 61 00"
    assert ask("06 00", vehicle) == "46 00 c0 00 00 01"
    assert ask("06 20", vehicle) == "46 20 80 00 00 01"
    assert ask("06 40", vehicle) == "46 40 40 00 00 00"
    assert ask("06 21", vehicle)[:44] == "46 21 80 36 00 06 00 0c 00 8c 21 81 20 00 80"  # type: ignore[index]
    assert "02 07 0b 00 50 00 1e 00 c8" in (ask("06 02", vehicle) or "")  # 80 mV of 30 to 200
    assert ask("06 42", vehicle) == "46 42 80 10 36 b0 00 00 61 a8"
    counters = struct.unpack(">20H", bytes.fromhex(ask("09 08", vehicle) or "")[3:])
    assert counters[2:4] == (1, 0)
    # WHEN the codes are cleared, THEN the catalyst is known, and not ready
    ask("04", vehicle)
    assert ask("01 01", vehicle) == "41 01 00 04 21 21"


def test_after_clearing_the_sensor_monitor_is_not_ready() -> None:
    vehicle = Vehicle()
    assert ask("04", vehicle) == "44"
    assert ask("01 01", vehicle) == "41 01 00 04 20 20"
    assert ask("03", vehicle) == "43 00"
    assert ask("07", vehicle) == "47 00"
    assert ask("02 02 00", vehicle) == "42 02 00 00 00"
    assert ask("0A", vehicle) == "4a 01 01 33"  # only driving takes a permanent code away


@pytest.mark.parametrize("fault", ["", "slow_rich_to_lean"])
def test_parameter_41_counts_what_has_passed_or_failed_in_this_driving_cycle(fault: str) -> None:
    vehicle = Vehicle()
    vehicle.store.start_driving_cycle()
    for test in ("bias", "activity"):
        vehicle.store.complete(test)
    assert ask("01 41", vehicle) == "41 41 00 04 20 20"
    _ = vehicle.store.fail(fault, 1) if fault else vehicle.store.complete("response")
    assert ask("01 41", vehicle) == "41 41 00 04 20 00"


def test_the_bitmaps_list_exactly_what_is_answered() -> None:
    # GIVEN a tester that follows the bitmaps from 00 on
    listed, base = set(), 0x00
    while True:
        bits = int.from_bytes(bytes.fromhex(ask(f"01 {base:02X}") or "")[2:], "big")
        listed |= {base + 32 - i for i in range(32) if bits >> i & 1}
        if not bits & 1:
            break
        base += 0x20
    # THEN what it finds is what there is, and nothing else is answered
    answered = {n for n in range(1, 0x100) if ask(f"01 {n:02X}", functional=True)}
    assert listed == answered
    assert {0x01, 0x1C, 0x20, 0x40, 0x41} <= listed
    assert 0x0C not in listed  # the engine's own control unit tells its speed


def test_up_to_six_parameters_are_answered_at_once_and_unknown_ones_left_out() -> None:
    assert ask("01 1C 0C 30 21 31 4E") == "41 1c 01 30 07 21 00 33 31 00 7b 4e 00 78"
    assert ask("01 1C 1C 1C 1C 1C 1C 1C") == "7f 01 12"


FRAME = (  # 90 degC, 45 kPa, 2000 1/min, 36 kg/h = 10 g/s, 10 MPa = 1000 times 10 kPa, +5 %
    "02 01 33, 05 82, 0B 2d, 0C 1f 40, 0D 50, 0F 46, 10 03 e8, 11 33, 23 03 e8, 24 80 00 00 00, "
    "44 73 33, 03 02 00, 06 86, 2E 66, 33 64, 42 30 d4, 46 3c"
)


@pytest.mark.parametrize("told", FRAME.split(", "))
def test_the_freeze_frame_is_told_in_the_units_of_the_standard(told: str) -> None:
    parameter, data = told.split(" ", 1)
    assert ask(f"02 {parameter} 00") == f"42 {parameter.lower()} 00 {data}"


def test_there_is_one_freeze_frame_and_only_what_it_holds() -> None:
    assert ask("02 02 01") == "7f 02 12"
    assert ask("02 04 00") == "7f 02 12"  # calculated load is no signal of ours
    assert ask("02 0C") == "7f 02 12"  # frame number missing
    assert ask("02 0C 00 0D 00 02 00") == "42 0c 00 1f 40 0d 00 50 02 00 01 33"


def test_test_results_carry_value_and_limits_in_their_scaling() -> None:
    answered = bytes.fromhex(ask("06 01") or "")
    rows = {answered[i + 1]: answered[i : i + 9] for i in range(1, len(answered), 9)}
    assert rows[0x80].hex(" ") == "01 80 10 01 36 00 00 00 fa"  # 310 ms of at most 250 ms
    assert struct.unpack(">3h", rows[0x85][3:]) == (-655, -1638, 1638)  # of 1/32768
    assert rows[0x84][3:] == bytes(6)  # never run
    assert ask("06 00") == "46 00 80 00 00 00"
    assert ask("06 02") == "7f 06 12"
    assert ask("06 01 00") == "46 00 80 00 00 00"  # results come alone


@pytest.mark.parametrize(
    ("scaling", "value", "data"),
    [
        (results.MILLISECONDS, 65.5, "ffdc"),
        (results.MILLISECONDS, math.inf, "ffff"),
        (results.MILLISECONDS, -0.1, "0000"),
        (results.RATIO, 0.75, "00c0"),
        (results.FINE_SIGNED, 5.0, "7fff"),
        (results.FINE_SIGNED, -math.inf, "8000"),
    ],
)
def test_a_result_beyond_its_scaling_is_held_at_its_end(
    scaling: results.ResultScaling, value: float, data: str
) -> None:
    assert scaling.encode(value).hex() == data


def test_every_result_of_the_monitor_is_told(setup: replay.Setup) -> None:
    # GIVEN what a drive with a late sensor leaves
    store = DtcStore()
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
    deque(pipeline.push(block_of(frames_of("delay_rich_to_lean", 50.0))), maxlen=0)
    told = [row[1] for row in results.test_results(0x01, store.results) if any(row[3:])]
    assert len(told) == len(store.results) > 3


def test_vehicle_information_names_vin_calibration_and_its_check() -> None:
    assert ask("09 02") == "49 02 01 " + VIN.encode().hex(" ")
    assert ask("09 04") == "49 04 01 " + b"shipped-01234567".hex(" ")
    assert ask("09 06") == "49 06 01 01 23 45 67"
    assert ask("09 0A") == "49 0a 01 " + b"O2M\0-OxygenMonitor\0\0".hex(" ")
    assert ask("09 00") == "49 00 55 40 00 00"


@pytest.mark.parametrize(
    ("model", "calibration"),
    [("m.onnx", "m-01234567"), ("own", "own-01234567"), ("größer als.onnx", "gr??er -01234567")],
)
def test_the_calibration_is_ascii_of_at_most_16_characters(model: str, calibration: str) -> None:
    assert Identity(model, SHA256, "carb").calibration_id == calibration


def test_without_a_vin_there_is_none() -> None:
    assert ask("09 00", Vehicle(vin=None)) == "49 00 15 40 00 00"
    assert ask("09 02", Vehicle(vin=None)) == "7f 09 12"


def test_in_use_performance_reports_the_lowest_ratio_and_cycles_that_begin_anew_at_65536() -> None:
    vehicle = Vehicle()
    vehicle.store.counts.ignition_cycles += 0x10000
    answered = bytes.fromhex(ask("09 08", vehicle) or "")
    assert answered[:3] == b"\x49\x08\x14"
    assert struct.unpack(">20H", answered[3:]) == (9, 11, 0, 0, 0, 0, 3, 5, *([0] * 12))


def test_a_vin_with_a_letter_that_no_vin_has_is_refused() -> None:
    with pytest.raises(UsageError, match="without I, O and Q"):
        Identity("m.onnx", SHA256, "carb", "WVWZZZ1JZXW38675O")


def made_of(command: obd.OBDCommand) -> Any:
    """Return what python-OBD, a scan tool, makes of the answer to one of its commands."""
    message = Message([])
    message.data = bytearray.fromhex(ask(command.command.decode()) or "")
    return command.decode([message])


def test_a_scan_tool_reads_lamp_readiness_codes_results_and_who_it_is() -> None:
    status = made_of(obd.commands.STATUS)
    assert (status.MIL, status.DTC_count, status.ignition_type) == (True, 1, "spark")
    ready = status.OXYGEN_SENSOR_MONITORING
    assert ready.available and ready.complete
    ((code, words),) = made_of(obd.commands.GET_DTC)
    assert code == "P0133" and "O2 Sensor Circuit Slow" in words
    assert {code for code, _ in made_of(obd.commands.GET_CURRENT_DTC)} == {code, "P2195"}
    lag = {each.tid: each for each in made_of(obd.commands.MONITOR_O2_B1S1).tests}[0x80]
    assert (lag.value.to("ms").magnitude, lag.max.to("ms").magnitude) == (310, 250)
    assert made_of(obd.commands.OBD_COMPLIANCE) == "OBD-II as defined by the CARB"
    assert made_of(obd.commands.VIN).decode() == VIN
    # it cuts the text short by one, and takes some figures for padding
    assert b"shipped-01234567".startswith(made_of(obd.commands.CALIBRATION_ID))
