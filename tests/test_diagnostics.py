"""Answers of the OBD and UDS services, without a bus."""

import math
import struct
from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor import config, enable, replay
from monitor.diagnostics import results
from monitor.diagnostics.answer import answer
from monitor.diagnostics.identifiers import IDENTIFIERS
from monitor.diagnostics.parameters import bitmap, unsigned
from monitor.diagnostics.state import Identity
from monitor.diagnostics.uds import dtc_bytes
from monitor.dtc import DtcStore, Status
from monitor.errors import UsageError
from monitor.obd_records import Ratio
from monitor.pipeline import FramePipeline, WindowJudged
from monitor.sources import read_frames
from monitor.window import Window
from tests.diagnostics_state import NAMES, SHA256, VIN, Vehicle, tick

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def late_sensor() -> DtcStore:
    """Return the fault memory after a drive with a late sensor."""
    (log,) = ROOT.glob("replay_logs/delay_rich_to_lean_*.blf")
    setup, store = replay.set_up(None, [], config.load()), DtcStore()
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
    for frame in list(read_frames(log))[: 200 * 150]:
        deque(pipeline.push(frame), maxlen=0)
    return store


def ask(request: str, vehicle: Vehicle | None = None, *, functional: bool = False) -> str | None:
    """Return the answer in hexadecimal."""
    found = answer(bytes.fromhex(request), functional, (vehicle or Vehicle()).state)
    return None if found is None else found.hex(" ")


# Services of SAE J1979


def test_parameter_01_tells_lamp_codes_and_that_the_sensor_monitor_has_completed() -> None:
    assert ask("01 01") == "41 01 81 04 20 00"


def test_after_clearing_the_sensor_monitor_is_not_ready() -> None:
    vehicle = Vehicle()
    assert ask("04", vehicle) == "44"
    assert ask("01 01", vehicle) == "41 01 00 04 20 20"
    assert ask("03", vehicle) == "43 00"
    assert ask("07", vehicle) == "47 00"
    assert ask("02 02 00", vehicle) == "42 02 00 00 00"
    assert ask("0A", vehicle) == "4a 01 01 33"  # only driving takes a permanent code away


def test_parameter_41_follows_this_driving_cycle() -> None:
    vehicle = Vehicle()
    vehicle.store.start_driving_cycle()
    assert ask("01 41", vehicle) == "41 41 00 04 20 20"
    for test in ("response", "bias", "activity", "ready", "range"):
        vehicle.store.complete(test)
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


def test_up_to_six_parameters_are_answered_at_once_and_unknown_ones_left_out() -> None:
    assert ask("01 1C 0C 30 21 31 4E") == "41 1c 01 30 07 21 00 33 31 00 7b 4e 00 78"
    assert ask("01 1C 1C 1C 1C 1C 1C 1C") == "7f 01 12"


def test_the_standard_is_that_of_the_profile() -> None:
    vehicle = Vehicle()
    vehicle.state.identity = Identity("m.onnx", SHA256, "0.1.0", "eobd")
    assert ask("01 1C", vehicle) == "41 1c 06"


@pytest.mark.parametrize(
    ("parameter", "data"),
    [
        ("02", "01 33"),
        ("05", "82"),  # 90 degC
        ("0B", "2d"),  # 45 kPa
        ("0C", "1f 40"),  # 2000 1/min
        ("0D", "50"),
        ("0F", "46"),
        ("10", "03 e8"),  # 36 kg/h = 10 g/s
        ("11", "33"),
        ("23", "03 e8"),  # 10 MPa = 1000 x 10 kPa
        ("24", "80 00 00 00"),
        ("44", "73 33"),
        ("03", "02 00"),
        ("06", "86"),  # +5 %
        ("2E", "66"),
        ("33", "64"),
        ("42", "30 d4"),
        ("46", "3c"),
    ],
)
def test_the_freeze_frame_is_told_in_the_units_of_the_standard(parameter: str, data: str) -> None:
    assert ask(f"02 {parameter} 00") == f"42 {parameter.lower()} 00 {data}"


def test_there_is_one_freeze_frame_and_only_what_it_holds() -> None:
    assert ask("02 02 01") == "7f 02 12"
    assert ask("02 04 00") == "7f 02 12"  # calculated load is no signal of ours
    assert ask("02 0C") == "7f 02 12"  # frame number missing
    assert ask("02 0C 00 0D 00 02 00") == "42 0c 00 1f 40 0d 00 50 02 00 01 33"


def test_codes_stand_under_confirmed_pending_and_permanent() -> None:
    assert ask("03") == "43 01 01 33"
    assert ask("07") == "47 02 01 33 21 95"
    assert ask("0A") == "4a 01 01 33"


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
    scaling: results.Scaling, value: float, data: str
) -> None:
    assert scaling.encode(value).hex() == data


def test_every_result_of_the_monitor_is_told(late_sensor: DtcStore) -> None:
    # GIVEN what a drive with a late sensor leaves
    told = [row[1] for row in results.test_results(0x01, late_sensor.results) if any(row[3:])]
    # THEN each of its results has an identifier
    assert len(told) == len(late_sensor.results) > 3


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
    assert Identity(model, SHA256, "0.1.0", "carb").calibration_id == calibration


def test_without_a_vin_there_is_none() -> None:
    assert ask("09 00", Vehicle(vin=None)) == "49 00 15 40 00 00"
    assert ask("09 02", Vehicle(vin=None)) == "7f 09 12"


def test_in_use_performance_reports_the_lowest_ratio_of_the_sensor_monitor() -> None:
    answered = bytes.fromhex(ask("09 08") or "")
    assert answered[:3] == b"\x49\x08\x14"
    assert struct.unpack(">20H", answered[3:]) == (9, 11, 0, 0, 0, 0, 3, 5, *([0] * 12))


def test_a_vin_with_a_letter_that_no_vin_has_is_refused() -> None:
    with pytest.raises(UsageError, match="without I, O and Q"):
        Identity("m.onnx", SHA256, "0.1.0", "carb", "WVWZZZ1JZXW38675O")


# Unified diagnostic services


def test_sessions_are_default_and_extended() -> None:
    vehicle = Vehicle()
    assert ask("10 03", vehicle) == "50 03 00 32 01 f4"
    assert ask("22 F1 86", vehicle) == "62 f1 86 03"
    assert ask("10 81", vehicle) is None  # positive response not wanted
    assert ask("22 F1 86", vehicle) == "62 f1 86 01"
    assert ask("10 02", vehicle) == "7f 10 12"
    assert ask("10", vehicle) == ask("10 01 00", vehicle) == "7f 10 13"


def test_tester_present_can_be_silent() -> None:
    assert ask("3E 00") == "7e 00"
    assert ask("3E 80") is None
    assert ask("3E 01") == ask("3E 81") == "7f 3e 12"


@pytest.mark.parametrize("group", ["FF FF FF", "FF FF 33"])
def test_clearing_needs_the_extended_session_and_the_engine_off(group: str) -> None:
    vehicle = Vehicle()
    assert ask(f"14 {group}", vehicle) == "7f 14 7f"
    assert ask(f"14 {group}", vehicle, functional=True) is None
    ask("10 03", vehicle)
    vehicle.state.push(tick(800.0))
    assert ask(f"14 {group}", vehicle) == "7f 14 22"
    assert vehicle.clearings == 0
    vehicle.state.push(tick(0.0))
    assert ask(f"14 {group}", vehicle) == "54"
    assert vehicle.clearings == 1


def test_only_whole_groups_are_cleared() -> None:
    vehicle = Vehicle()
    ask("10 03", vehicle)
    assert ask("14 01 33 00", vehicle) == "7f 14 31"
    assert ask("14 FF FF", vehicle) == "7f 14 13"
    assert vehicle.clearings == 0


@pytest.mark.parametrize("speed_rpm", [800.0, 500.0, math.nan, None])
def test_service_04_does_nothing_while_the_engine_runs_or_nobody_knows(
    speed_rpm: float | None,
) -> None:
    vehicle = Vehicle(speed_rpm)
    assert ask("04", vehicle) == "7f 04 22"
    assert ask("04", vehicle, functional=True) == "7f 04 22"
    assert vehicle.clearings == 0
    vehicle.state.clear_while_running = True
    assert ask("04", vehicle) == "44"


def test_a_memory_that_cannot_be_stored_is_not_called_cleared() -> None:
    vehicle = Vehicle()
    vehicle.fails = True
    ask("10 03", vehicle)
    assert ask("04", vehicle) == "7f 04 22"
    assert ask("14 FF FF FF", vehicle) == "7f 14 72"


def test_codes_are_counted_and_listed_by_status() -> None:
    assert ask("19 01 08") == "59 01 ff 00 00 01"
    assert ask("19 02 0C") == "59 02 ff 01 33 00 8d 21 95 00 04"
    assert ask("19 02 00") == "59 02 ff"
    supported = bytes.fromhex(ask("19 0A") or "")
    assert len(supported) == 3 + 4 * len(DtcStore().all)
    assert ask("19 82 FF") is None


def test_every_code_has_three_bytes_of_its_own() -> None:
    codes = [dtc.code for dtc in DtcStore().all]
    assert len({dtc_bytes(code) for code in codes}) == len(codes)
    assert dtc_bytes("U0100").hex() == "c10087"  # message missing


def test_a_snapshot_holds_the_freeze_frame_as_parameters() -> None:
    answered = bytes.fromhex(ask("19 04 01 33 00 FF") or "")
    assert answered[:8].hex(" ") == "59 04 01 33 00 8d 01 10"
    assert b"\xf4\x0c\x1f\x40" in answered
    assert ask("19 04 01 33 00 01") == answered.hex(" ")
    assert ask("19 04 21 95 00 FF") == "59 04 21 95 00 04"  # pending, no frame kept
    assert ask("19 04 01 33 00 02") == "7f 19 31"
    assert ask("19 04 12 34 00 FF") == "7f 19 31"


def test_extended_data_counts_failing_healing_and_ageing() -> None:
    everything = "01 02 02 00 03 00 04 01 05 00 03 00 05"
    assert ask("19 06 01 33 00 FF") == f"59 06 01 33 00 8d {everything}"
    assert ask("19 06 21 95 00 03") == "59 06 21 95 00 04 03 03"
    assert ask("19 06 21 95 00 06") == "7f 19 31"


def test_a_code_that_fails_in_this_driving_cycle_counts_it() -> None:
    vehicle = Vehicle()
    vehicle.store.fail("gain_low", 0)
    assert (ask("19 06 2A 00 00 01", vehicle) or "").endswith("01 01")
    assert Status.FAILED_THIS_CYCLE in next(
        d.status for d in vehicle.store.all if d.code == "P2A00"
    )


def test_the_ratio_of_a_code_is_that_of_its_test() -> None:
    vehicle = Vehicle()
    assert Ratio("bias", 4, 5) in vehicle.store.ratios
    assert ask("19 06 21 96 00 05", vehicle) == "59 06 21 96 00 50 05 00 04 00 05"


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("19", "13"),
        ("19 02", "13"),
        ("19 04 01 33 00", "13"),
        ("19 03", "12"),
        ("22", "13"),
        ("22 F1", "13"),
        ("22 F1 90 F1", "13"),
        ("22" + " F1 90" * 17, "13"),
        ("22" + " FD 00" * 16, "14"),
        ("22 FE 00", "31"),
        ("05", "11"),
        ("27 01", "11"),
        ("31 01 00 00", "11"),
        ("7F", "11"),
    ],
)
def test_what_cannot_be_answered_is_refused_with_its_reason(request_: str, code: str) -> None:
    assert ask(request_) == f"7f {request_[:2].lower()} {code}"
    sent_to_all = ask(request_, functional=True)
    assert sent_to_all == (None if code in ("11", "12", "31") else f"7f {request_[:2]} {code}")


def test_the_monitors_state_is_read_by_identifier() -> None:
    vehicle = Vehicle(1500.0)
    answered = bytes.fromhex(ask("22 FD 02 FD 03 FD 04 FD 05 FD 06 FD 08", vehicle) or "")
    measured, predicted, residual = (
        struct.unpack(">f", answered[i : i + 4])[0] for i in (3, 9, 15)
    )
    assert (measured, predicted, residual) == pytest.approx((1.02, 1.0, 0.02), abs=1e-6)
    assert answered[19:22] == b"\xfd\x05\x00"
    assert answered[22:28] == b"\xfd\x06\x00\x00\x00\x05"
    assert answered[28:31] == b"\xfd\x08\xff"  # no window yet
    assert ask("22 FD 00", vehicle) == "62 fd 00 " + bytes.fromhex(SHA256).hex(" ")
    assert ask("22 F1 90 FE 00", vehicle) == "62 f1 90 " + VIN.encode().hex(" ")


def test_windows_and_samples_are_counted_and_the_last_verdict_is_told() -> None:
    vehicle = Vehicle(1500.0)
    vehicle.state.push(tick(1500.0)._replace(enabled=True))
    for outcome in ("passed", "failed"):
        window = Window(0, 0, 5_000_000_000, np.zeros(50), np.zeros(50), np.zeros((1, 50)))
        vehicle.state.push(
            WindowJudged(window, 0.25, 0.5, False, outcome, "gain_low", (), True, {})
        )
    assert ask("22 FD 05", vehicle) == "62 fd 05 01"
    assert ask("22 FD 07", vehicle) == "62 fd 07 00 00 00 02"
    verdict = struct.pack(">Bff", 1, 0.25, 0.5).hex(" ")
    assert ask("22 FD 08", vehicle) == "62 fd 08 " + verdict
    assert ask("22 FD 09", vehicle) == "62 fd 09 00 00 00 02 00 00 00 01"


def test_a_number_just_beyond_a_bitmap_is_announced() -> None:
    assert bitmap({0x21}, 0x00) == bytes.fromhex("00000001")
    assert bitmap({0x20}, 0x00) == bytes.fromhex("00000001")
    assert bitmap({0x21}, 0x20) == bytes.fromhex("80000000")
    assert bitmap({0x20}, 0x20) is None
    assert bitmap(set(), 0x00) == bytes(4)
    assert bitmap({0x01}, 0x01) is None


def test_counters_stay_at_their_end() -> None:
    assert [unsigned(value, 1)[0] for value in (254.6, 255.0, 255.9, 1e9)] == [255] * 4


def test_before_the_first_sample_values_are_not_numbers() -> None:
    vehicle = Vehicle(None)
    for identifier in ("FD 02", "FD 03", "FD 04"):
        value = bytes.fromhex(ask(f"22 {identifier}", vehicle) or "")[3:]
        assert math.isnan(struct.unpack(">f", value)[0])
    assert ask("22 F4 0C", vehicle) == "7f 22 31"
    assert len(NAMES) == len(vehicle.state.names)


def test_the_document_names_every_identifier_and_the_bits_of_the_conditions() -> None:
    text = (ROOT / "docs/diagnostics.md").read_text()
    assert all(f"{number:04X}" in text for number in IDENTIFIERS)
    assert ", ".join(enable.CONDITIONS) in text


@settings(max_examples=500)
@given(st.one_of(st.binary(max_size=70), st.binary(max_size=9).map(lambda b: b"\x19" + b)))
def test_every_request_is_answered_refused_or_met_with_silence(request_: bytes) -> None:
    vehicle = Vehicle(engine_speed_rpm=800.0)
    for functional in (False, True):
        answered = answer(request_, functional, vehicle.state)
        if answered is None:
            continue
        if answered[0] == 0x7F:
            assert answered[1] == request_[0]
            assert len(answered) == 3
        else:
            assert answered[0] == request_[0] + 0x40
            assert len(answered) <= 512
    assert vehicle.clearings == 0
