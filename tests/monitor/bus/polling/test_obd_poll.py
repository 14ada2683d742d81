"""Polling by OBD-II, against an ECU on can-isotp."""

import argparse
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.command_line import signature
from monitor.base.errors import UsageError
from monitor.base.types import Frame
from monitor.bus.polling.answer import EcuAddress
from monitor.bus.polling.pids import BITMAPS, wanted
from monitor.bus.polling.poller import ObdPoller
from monitor.bus.polling.schedule import Schedule
from monitor.cli import options
from monitor.decode.obd_answers import Reassembly, values_of
from tests.helpers.bus.obd_ecu import J1979, PARAMETERS, STEADY, Conversation, steady_ecu
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import OBD


def assert_as_the_ecu_has_it(talk: Conversation) -> None:
    """Compare with the steady values through J1979's quantisation, in the map's units."""
    rate_l_h = round(STEADY["fuel_mass_mg"] * STEADY["engine_speed_rpm"] * 120 / 745e3 * 20) / 20
    known = STEADY | {"fuel_rate_l_h": rate_l_h}
    for name in ("throttle_percent", "purge_duty_percent"):
        known[name] = round(STEADY[name] * 2.55) / 2.55
    for name, values in talk.values.items():
        assert values, name
        assert values == pytest.approx([known[name]] * len(values), rel=1e-9), name


def test_every_mapped_value_arrives_as_the_ecu_has_it_six_parameters_in_one_request() -> None:
    talk = Conversation(steady_ecu()).run(5.0)
    assert_as_the_ecu_has_it(talk)
    assert {len(request) for request in talk.asked[3:]} == {6}


def test_ranges_of_the_ecu_are_asked_for_first_and_scale_its_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # GIVEN an ECU that sends lambda up to 4, pressure up to 510 kPa and air up to 1310.7 g/s
    ranges = {0x4F: (4, lambda _: 0x04000033), 0x50: (4, lambda _: 0x83000000)}
    halved = {pid: (J1979[pid][0], lambda r, of=J1979[pid][1]: of(r) / 2) for pid in (0x0B, 0x44)}
    air = {0x10: (2, lambda r: r["maf_kg_h"] / 3.6 * 100 * 655.35 / 1310)}
    for pid, of in {**ranges, **halved, **air}.items():
        monkeypatch.setitem(J1979, pid, of)
    monkeypatch.setitem(STEADY, "manifold_pressure_kpa", 46.0)
    talk = Conversation(steady_ecu(supported=(0x0B, 0x10, 0x44, 0x4F, 0x50))).run(5.0)
    assert talk.asked[3][:2] == (0x4F, 0x50)
    assert set(talk.values["manifold_pressure_kpa"]) == {46.0}
    assert set(talk.values["lambda_target"]) == {1.0}
    assert talk.values["maf_kg_h"][0] == pytest.approx(39.6, rel=1e-3)


def test_bitmaps_come_first_and_only_what_is_supported_and_mapped_is_asked_for() -> None:
    talk = Conversation(steady_ecu(supported=(0x05, 0x0C, 0x0D, 0x1C, 0x34, 0x44))).run(5.0)
    assert talk.asked[:3] == [(0x00,), (0x20,), (0x40,)]
    assert {pid for request in talk.asked[3:] for pid in request} == {0x05, 0x0C, 0x0D, 0x34, 0x44}
    (line,) = talk.said
    assert "05 34 44 0C 0D" in line
    assert "fuel_rate_l_h (5E)" in line


def test_the_sensor_behind_the_catalyst_is_asked_for_on_demand() -> None:
    parser = argparse.ArgumentParser()
    signature.add_options(parser, options.ObdOptions)

    def asked(*words: str) -> set[int]:
        poller = options.obd_poller(parser.parse_args(["--obd", *words]), OBD)
        return {pid for each in poller.schedule.parameters for pid in each.pids}

    assert asked("--obd-optional") - asked() == {0x15, 0x25, 0x35, 0x3C, 0x3E}


@pytest.mark.parametrize(
    ("name", "supported", "asked"),
    [
        ("catalyst_temperature_degc", (0x3C, 0x3E), 0x3C),
        ("catalyst_temperature_degc", (0x3E,), 0x3E),
        ("downstream_lambda", (0x25,), 0x25),
        ("downstream_lambda", (0x35,), 0x35),
    ],
)
def test_a_value_of_two_parameters_comes_from_the_one_that_the_engine_has(
    name: str, supported: tuple[int, ...], asked: int
) -> None:
    *_, parameter = wanted(OBD, [name])
    schedule = Schedule([parameter])
    for bitmap in BITMAPS[:2]:
        assert schedule.choose(0.0) == (bitmap,)
        own = [pid for pid in (*supported, 0x20) if bitmap < pid <= bitmap + 0x20]
        bits = sum(1 << (bitmap + 0x20 - pid) for pid in own)
        schedule.answered((bitmap,), {bitmap: bits.to_bytes(4, "big")})
    assert schedule.choose(1.0) == (asked,)


def test_no_more_requests_go_out_than_the_rate_allows_and_one_at_a_time() -> None:
    talk = Conversation(steady_ecu(), rate_hz=10.0).run(10.0)
    times_s = np.array([t for t, _ in talk.ecu.asked])
    assert np.diff(times_s).min() >= 0.1 - 1e-9
    assert len(times_s) == pytest.approx(100, abs=3)
    answered = talk.poller.counters
    assert answered.requests - answered.answers <= 1
    assert answered.silent == answered.malformed == 0


def test_fast_signals_are_polled_more_often_than_slow_ones() -> None:
    values = Conversation(steady_ecu()).run(20.0).values
    assert len(values["lambda_measured"]) / 20 > 4
    assert len(values["engine_speed_rpm"]) / 20 > 4
    assert 0.2 < len(values["ambient_pressure_kpa"]) / 20 < 1
    for name, seen in values.items():
        assert len(seen) >= 3 * 20 / OBD.channels[name].mapped.timeout_s, name


def test_an_ecu_that_refuses_several_or_answers_the_first_alone_is_polled_one_by_one() -> None:
    refusing, first = steady_ecu(at_once=1), steady_ecu()
    first.override = lambda r: None if len(r) == 2 else [b"\x41" + first._data(r[1], 0.0)]
    for ecu in (refusing, first):
        talk = Conversation(ecu).run(20.0)
        assert sum(len(request) > 1 for request in talk.asked) <= 5
        assert_as_the_ecu_has_it(talk)


def test_after_answers_to_another_tester_several_are_asked_for_again() -> None:
    talk = Conversation(steady_ecu()).run(1.0)
    for k, data in enumerate(10 * ("04410C20D1AAAAAA", "037F0112AAAAAAAA")):
        talk.bus.put(talk.bus.now_s + 0.1 * k, 0x7E8, bytes.fromhex(data))
    assert [len(request) for request in talk.run(12.0).asked[-20:]] == [6] * 20


def test_a_bitmap_that_is_announced_but_never_answered_holds_up_nothing() -> None:
    ecu = steady_ecu()
    ecu.override = lambda r: [] if r == b"\x01\x20" else None
    assert Conversation(ecu).run(10.0).polled == {pid for pid in J1979 if pid < 0x20}


def test_a_parameter_that_is_announced_but_never_answered_does_not_hold_up_the_others() -> None:
    ecu = steady_ecu()
    own = ecu._data
    ecu._data = lambda pid, now_s: b"" if pid == 0x23 else own(pid, now_s)  # type: ignore[method-assign]
    talk = Conversation(ecu).run(30.0)
    assert 0x23 not in talk.polled
    assert len(talk.polled) == sum(bool(each.names) for each in PARAMETERS) - 1
    assert [len(request) for request in talk.asked[-20:]] == [6] * 20


def test_nothing_is_asked_beside_a_pending_answer() -> None:
    talk = Conversation(steady_ecu()).run(1.0).answered_with([b"\x7f\x01\x78"], 0.2)
    before = len(talk.asked)
    assert len(talk.run(3.0).asked) == before  # waits for the answer to come
    for k in range(60):
        talk.bus.put(talk.bus.now_s + k, 0x7E8, b"\x03\x7f\x01\x78")
    assert len(talk.run(60.0).asked) > before + 5  # but not for ever, whatever it says


def test_a_busy_ecu_is_asked_ever_less_often_and_normally_again_later() -> None:
    talk = Conversation(steady_ecu()).run(1.0).answered_with([b"\x7f\x01\x21"], 30.0)
    pauses_s = np.diff([t for t, _ in talk.ecu.asked if t > 1.2])
    assert np.all(np.diff(pauses_s) > -0.05)
    assert 4.9 < pauses_s[-1] < 5.2
    before = len(talk.answered_with(None, 6.0).asked)
    assert len(talk.run(5.0).asked) - before > 50


def test_a_silent_bus_is_asked_seldom_and_a_returning_ecu_is_found_and_asked_anew() -> None:
    talk = Conversation(steady_ecu()).run(2.0).answered_with([], 60.0)
    assert sum(t > 40.0 for t, _ in talk.ecu.asked) <= 5
    talk.ecu.supported = (0x0C, 0x0D)
    assert talk.answered_with(None, 7.0).polled == {0x0C, 0x0D}
    assert sum(t > 69.0 - 1.0 for t, _ in talk.ecu.asked) > 8


@pytest.mark.parametrize(
    ("requests", "response"),
    [((0x7DF,), 0x7E8), ((0x7DF, 0x7E0), 0x7E8), ((0x18DB33F1, 0x18DA10F1), 0x18DAF110)],
)
def test_the_ecu_is_found_however_it_is_addressed(requests: tuple[int, ...], response: int) -> None:
    ecu = steady_ecu(
        requests=(*requests, 0x7E0) if response == 0x7E8 else requests, response=response
    )
    if requests == (0x7DF,):  # a gateway that lets only flow control through, and refuses the rest
        own = [b"\x7f\x01\x11"]
        ecu.override = lambda r: own if talk.bus.sent[-1][1].arbitration_id == 0x7E0 else None
    talk = Conversation(ecu)
    talk.run(12.0)
    assert_as_the_ecu_has_it(talk)
    extended = {m.is_extended_id for _, m in talk.bus.sent if m.arbitration_id in requests}
    assert extended == {response > 0x7FF}


def test_a_lost_frame_costs_one_answer_and_brings_no_wrong_value() -> None:
    talk = Conversation(steady_ecu())
    talk.bus.loss = 0.03
    talk.run(60.0)
    assert_as_the_ecu_has_it(talk)
    assert len(talk.values["lambda_measured"]) > 120
    assert talk.poller.counters.silent > 5


def test_answers_to_other_testers_are_neither_acknowledged_nor_counted() -> None:
    poller = ObdPoller(PARAMETERS)
    poller.work(0.0)  # asks for the bitmap 00
    for data in ("100E410C1AF80D2A", "0441 0C1AF8", "037F0222", "0749020131"):
        poller.receive(Frame(0, 0x7E8, False, bytes.fromhex(data)))
        assert poller.work(0.01) == []
    assert poller.counters.malformed == poller.counters.refused == poller.counters.answers == 0


def test_flow_control_goes_to_the_engine_alone_when_all_were_asked() -> None:
    ecu = steady_ecu(requests=(0x7DF, 0x7E0))
    talk = Conversation(ecu, addresses=[EcuAddress.of(0x7DF)]).run(3.0)
    flow = [m.arbitration_id for _, m in talk.bus.sent if m.data[0] == 0x30]
    asked = [m.arbitration_id for _, m in talk.bus.sent if m.data[0] != 0x30]
    assert (set(flow), set(asked)) == ({0x7E0}, {0x7DF})
    assert len(flow) <= len(asked)


def test_an_answer_with_a_frame_missing_is_thrown_away() -> None:
    subject = Reassembly()
    whole = "1014410B2F0C20CD", "210D530547342AAA", "225555AAAAAAAAAA"
    frames = list(map(bytes.fromhex, whole))
    assert [subject.push(data) for data in frames[:2]] == [None, None]
    assert len(subject.push(frames[2]) or b"") == 0x14
    subject.push(frames[0])
    assert subject.push(frames[2]) is None
    assert not subject.is_running
    assert [subject.push(data) for data in frames[1:]] == [None, None]


def test_a_parameter_that_is_cut_short_says_nothing() -> None:
    assert values_of(bytes.fromhex("410D530C1A"), (0x0C, 0x0D)) == [(0x0D, b"\x53")]
    assert values_of(b"\x41", (0x0C,)) == []


@pytest.mark.parametrize("request_id", [0x123, 0x7E8, 0x18DAF1F1, 0x18DA10F2, -1])
def test_an_identifier_that_is_no_request_is_refused(request_id: int) -> None:
    with pytest.raises(UsageError, match="no identifier of an OBD-II request"):
        EcuAddress.of(request_id)


@inputs(200)
@given(data=st.data())
def test_no_frames_upset_the_poller_and_the_requests_stay_polite(data: st.DataObject) -> None:
    poller = ObdPoller(PARAMETERS)
    now_s, requests = 0.0, []
    start = st.sampled_from([b"\x41", b"\x7f\x01", b"\x06\x41\x00", b"\x10\x20\x41\x0c", b"\x21"])
    payloads = st.one_of(
        st.binary(max_size=8), st.tuples(start, st.binary(max_size=8)).map(b"".join)
    )
    for _ in range(40):
        now_s += data.draw(st.floats(0, 0.6))
        poller.receive(Frame(0, 0x7E8, False, data.draw(payloads)[:8]))
        for frame in poller.work(now_s):
            if frame.data[0] != 0x30:
                requests.append(now_s)
                assert frame.data[0] <= 7
    assert all(b - a >= 1 / 12 - 1e-9 for a, b in itertools.pairwise(requests))
