"""Answers of the UDS services, without a bus."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.bus.diagnostics.answer import answer
from monitor.bus.diagnostics.identifiers import IDENTIFIERS
from monitor.bus.diagnostics.reports import dtc_bytes
from monitor.judge import enable
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import Ratio
from tests.conftest import ROOT
from tests.helpers.bus.diagnostics_state import NAMES, SHA256, VIN, Vehicle, ask, tick
from tests.helpers.examples import inputs
from tests.helpers.models.windows import judged_window


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
    assert answered[:8].hex(" ") == "59 04 01 33 00 8d 00 10"
    assert b"\xf4\x0c\x1f\x40" in answered
    first = bytes.fromhex(ask("19 04 01 33 00 01") or "")
    assert (first[6], first[7:]) == (1, answered[7 : len(first)])
    assert ask("19 04 21 95 00 FF") == "59 04 21 95 00 04"  # pending, no frame kept
    assert ask("19 04 01 33 00 02") == "7f 19 31"
    assert ask("19 04 12 34 00 FF") == "7f 19 31"


def test_extended_data_counts_failing_healing_and_ageing() -> None:
    everything = "01 02 02 00 03 00 04 01 05 00 03 00 05"
    assert ask("19 06 01 33 00 FF") == f"59 06 01 33 00 8d {everything}"
    assert ask("19 06 21 95 00 03") == "59 06 21 95 00 04 03 03"
    assert ask("19 06 21 95 00 06") == "7f 19 31"


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
        ("19 05 01", "12"),
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
        vehicle.state.push(judged_window(0.25, 0.5, outcome, "gain_low"))
    assert ask("22 FD 05", vehicle) == "62 fd 05 01"
    assert ask("22 FD 07", vehicle) == "62 fd 07 00 00 00 02"
    verdict = struct.pack(">Bff", 1, 0.25, 0.5).hex(" ")
    assert ask("22 FD 08", vehicle) == "62 fd 08 " + verdict
    assert ask("22 FD 09", vehicle) == "62 fd 09 00 00 00 02 00 00 00 01"


def test_before_the_first_sample_values_are_not_numbers() -> None:
    vehicle = Vehicle(None)
    for identifier in ("FD 02", "FD 03", "FD 04"):
        value = bytes.fromhex(ask(f"22 {identifier}", vehicle) or "")[3:]
        assert math.isnan(struct.unpack(">f", value)[0])
    assert ask("22 F4 0C", vehicle) == "7f 22 31"
    assert len(NAMES) == len(vehicle.state.names)


def test_the_document_names_every_identifier_and_the_bits_of_the_conditions() -> None:
    text = (ROOT / "docs/reference/diagnostics.md").read_text()
    assert all(f"{number:04X}" in text for number in IDENTIFIERS)
    assert ", ".join(enable.CONDITIONS) in text


@inputs(500)
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
