"""Answers of the UDS services, without a bus."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.bus.diagnostics.server import answer
from monitor.bus.diagnostics.uds import REPORTS, dtc_bytes
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import Ratio
from tests.helpers.bus.diagnostics_state import Vehicle, ask, tick
from tests.helpers.examples import inputs


def test_sessions_are_default_and_extended() -> None:
    vehicle = Vehicle()
    assert ask("10 03", vehicle) == "50 03 00 32 01 f4"
    assert vehicle.state.session == 3
    assert ask("10 81", vehicle) is None  # positive response not wanted
    assert vehicle.state.session == 1
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
def test_service_04_does_nothing_unless_the_engine_stands(speed_rpm: float | None) -> None:
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


def test_codes_are_listed_by_status() -> None:
    assert ask("19 02 0C") == "59 02 ff 01 33 00 8d 21 95 00 04"
    assert ask("19 02 00") == "59 02 ff"
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
        *((each, "13") for each in ("19", "19 02", "19 04 01 33 00")),
        ("19 05 01", "12"),
        *((each, "11") for each in ("05", "22 F1 90", "27 01", "31 01 00 00", "7F")),
    ],
)
def test_what_cannot_be_answered_is_refused_with_its_reason(request_: str, code: str) -> None:
    assert ask(request_) == f"7f {request_[:2].lower()} {code}"
    sent_to_all = ask(request_, functional=True)
    assert sent_to_all == (None if code in ("11", "12", "31") else f"7f {request_[:2]} {code}")


def test_all_other_reports_of_codes_are_refused() -> None:
    for subfunction in {*range(0x80)} - {*REPORTS}:
        assert ask(f"19 {subfunction:02X} 01 33 00 FF") == "7f 19 12"


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
