"""Frames of a tester in, frames of answers out: ISO-TP, sessions, limits, garbage."""

import math
from collections.abc import Iterator

import isotp.tools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import UsageError
from monitor.base.types import Frame
from monitor.bus.diagnostics.server import BURST_FRAMES, FRAMES_PER_S, Diagnostics
from monitor.bus.polling.answer import EcuAddress
from tests.helpers.bus.diagnostics_state import Vehicle, tick
from tests.helpers.examples import inputs

FUNCTIONAL, REQUEST, RESPONSE = 0x7DF, 0x7E1, 0x7E9


class Clock:
    """Stands in for the module ``time`` inside can-isotp."""

    now_s = 100.0

    def perf_counter_ns(self) -> int:
        return round(self.now_s * 1e9)


CLOCK = Clock()


@pytest.fixture(autouse=True, scope="module")
def own_clock() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(isotp.tools, "time", CLOCK)
        yield


class Tester:
    """Sends frames to a monitor and looks at what comes back; time passes when it says so."""

    __test__ = False

    def __init__(self, vehicle: Vehicle | None = None) -> None:
        self.vehicle = vehicle or Vehicle()
        self.server = Diagnostics(self.vehicle.state)

    def send(self, data: str | bytes, can_id: int = REQUEST) -> list[str]:
        """Send one frame; return the frames that come at once, in hexadecimal."""
        payload = bytes.fromhex(data) if isinstance(data, str) else data
        self.server.receive(Frame(0, can_id, False, payload))
        return self.work()

    def work(self) -> list[str]:
        frames = list(self.server.work(CLOCK.now_s))
        assert all(f.can_id == RESPONSE and not f.is_extended for f in frames)
        assert all(len(f.data) == 8 for f in frames)
        return [f.data.hex(" ") for f in frames]

    def rest(self) -> list[str]:
        """Return the frames of an answer that follow, without the tester's doing."""
        frames = []
        for _ in range(100):
            if self.server.due_s - CLOCK.now_s >= 0.5:
                return frames
            CLOCK.now_s = self.server.due_s
            frames += self.work()
        raise AssertionError("the server is due without end")


@pytest.fixture
def tester() -> Tester:
    return Tester()


def test_a_request_to_all_and_one_to_this_monitor_are_answered_alike() -> None:
    for can_id in (FUNCTIONAL, REQUEST):
        assert Tester().send("02 01 1C", can_id) == ["03 41 1c 01 cc cc cc cc"]


def test_what_is_refused_is_told_only_to_who_asked_this_monitor() -> None:
    assert Tester().send("01 3F") == ["03 7f 3f 11 cc cc cc cc"]
    assert Tester().send("01 3F", FUNCTIONAL) == []


RESERVED = ("7F", "80", "F0", "FA", "FF")


@pytest.mark.parametrize(
    ("separation", "least_s"),
    [("00", 0.002), ("F1", 0.002), ("F9", 0.002), ("05", 0.005), *((x, 0.127) for x in RESERVED)],
)
def test_frames_keep_the_separation_asked_for_no_less_than_two_milliseconds_a_reserved_one_127(
    tester: Tester, separation: str, least_s: float
) -> None:
    tester.send("02 09 08")
    tester.send(f"30 00 {separation}")
    before_s = CLOCK.now_s
    assert tester.work() == []
    assert len(tester.rest()) == 6
    assert 6 * least_s <= CLOCK.now_s - before_s < 6 * least_s + 0.001


def test_an_answer_that_nobody_lets_go_on_is_given_up_after_a_second(tester: Tester) -> None:
    tester.send("02 09 02")
    CLOCK.now_s += 0.99
    assert tester.send("02 01 1C") == []
    CLOCK.now_s += 0.02
    assert tester.server.due_s < CLOCK.now_s
    assert tester.work() == []
    assert tester.send("02 01 1C") == ["03 41 1c 01 cc cc cc cc"]
    assert tester.server.due_s == math.inf


def test_a_request_in_several_frames_is_answered(tester: Tester) -> None:
    assert tester.send("10 09 19 02 FF FF FF FF") == ["30 00 00 cc cc cc cc cc"]
    assert tester.send("21 FF FF FF") == ["03 7f 19 13 cc cc cc cc"]


@pytest.mark.parametrize("length", ["10 41", "1F FF", "10 00 00 00 10 00", "10 00 FF FF FF FF"])
def test_a_request_too_long_is_refused_at_its_first_frame(tester: Tester, length: str) -> None:
    frame = bytes.fromhex(length).ljust(8, b"\x22")
    assert tester.send(frame) == ["32 00 00 cc cc cc cc cc"]
    for number in range(40):  # it is sent all the same
        assert tester.send(bytes((0x20 | (number + 1) % 16,)) + bytes(7)) == []
    CLOCK.now_s += 1.0
    assert tester.send("02 01 1C") == ["03 41 1c 01 cc cc cc cc"]


def test_a_wrong_sequence_number_ends_the_request(tester: Tester) -> None:
    tester.send("10 09 19 02 FF FF FF FF")
    assert tester.send("22 FF FF FF") == []
    assert tester.send("21 FF FF FF") == []
    assert tester.send("02 01 1C") == ["03 41 1c 01 cc cc cc cc"]


def test_several_frames_to_all_are_no_request(tester: Tester) -> None:
    assert tester.send("10 09 19 02 FF FF FF FF", FUNCTIONAL) == []
    assert tester.send("21 FF FF FF", FUNCTIONAL) == []


@pytest.mark.parametrize(
    "data", ["", "00", "08", "0F 01", "02 01", "30", "31 00 00", "30 00 00", "40 00", "FF" * 8]
)
def test_frames_that_mean_nothing_are_not_answered(data: str) -> None:
    for can_id in (REQUEST, FUNCTIONAL):
        tester = Tester()
        assert tester.send(data, can_id) == []
        assert tester.send("02 01 1C") == ["03 41 1c 01 cc cc cc cc"]


def test_one_answer_at_a_time(tester: Tester) -> None:
    tester.send("02 09 02")
    assert tester.send("02 01 1C") == []
    assert tester.send("02 01 1C", FUNCTIONAL) == []
    assert [f[:2] for f in tester.send("30 00 00") + tester.rest()] == ["21", "22"]


def test_the_extended_session_ends_five_seconds_after_the_last_request(tester: Tester) -> None:
    tester.send("02 10 03")
    CLOCK.now_s += 4.9
    assert tester.send("02 3E 80") == []
    CLOCK.now_s += 4.9
    assert tester.send("02 3E 80") == []
    assert tester.vehicle.state.session == 3
    CLOCK.now_s += 5.0
    assert tester.send("02 3E 80") == []
    assert tester.vehicle.state.session == 1


def test_clearing_is_announced_before_it_is_done(tester: Tester) -> None:
    assert tester.send("01 04", FUNCTIONAL) == ["03 7f 04 78 cc cc cc cc"]
    assert tester.vehicle.clearings == 0
    assert tester.server.due_s == CLOCK.now_s
    assert tester.work() == ["01 44 cc cc cc cc cc cc"]
    assert tester.vehicle.clearings == 1


def test_an_engine_that_starts_in_between_stops_the_clearing(tester: Tester) -> None:
    tester.send("01 04")
    tester.server.push(tick(800.0))
    assert tester.work() == ["03 7f 04 22 cc cc cc cc"]
    assert tester.vehicle.clearings == 0


def test_a_flood_is_answered_as_often_as_allowed_and_then_ignored(tester: Tester) -> None:
    answers = 0
    for _ in range(4000):  # one second of a full bus
        answers += len(tester.send("02 01 1C"))
        CLOCK.now_s += 1.0 / 4000
    assert abs(answers - BURST_FRAMES - FRAMES_PER_S) <= 2
    CLOCK.now_s += 1.0
    assert tester.send("02 01 1C") == ["03 41 1c 01 cc cc cc cc"]


def test_flow_control_of_an_answer_is_read_in_a_flood_too(tester: Tester) -> None:
    for _ in range(BURST_FRAMES - 1):
        tester.send("02 3E 80")
    assert tester.send("02 09 02") == ["10 14 49 02 01 57 56 57"]
    assert tester.send("02 3E 80") == []
    assert [f[:2] for f in tester.send("30 00 00") + tester.rest()] == ["21", "22"]


@pytest.mark.parametrize("text", ["7E8", "7E0", "7F0", "18DAF110", "18DAF133", "18DB33F1", "", "x"])
def test_identifiers_of_others_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="wanted 7E9 to 7EF"):
        EcuAddress.answering(text)


def test_29_bit_identifiers_are_answered_under_29_bits() -> None:
    vehicle = Vehicle()
    server = Diagnostics(vehicle.state, "0x18daf1a5")
    assert set(server.identifiers) == {(0x18DB33F1, True), (0x18DAA5F1, True)}
    server.receive(Frame(0, 0x18DAA5F1, True, bytes.fromhex("02011C")))
    (frame,) = server.work(0.0)
    assert (frame.can_id, frame.is_extended) == (0x18DAF1A5, True)
    server.receive(Frame(0, 0x18DB33F1, True, bytes.fromhex("02011C")))
    assert len(list(server.work(0.0))) == 1


TELLING = "0104 021003 0414FFFFFF 020902 0322FD00 300000 300100 310000 1009022F186F18 2100FE01"
FRAMES = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([bytes.fromhex(text) for text in (*TELLING.split(), "10FF000000")]),
)


@inputs(300)
@given(st.lists(st.tuples(st.sampled_from([FUNCTIONAL, REQUEST]), FRAMES), max_size=60))
def test_while_the_engine_runs_no_code_changes(frames: list[tuple[int, bytes]]) -> None:
    tester = Tester(Vehicle(engine_speed_rpm=800.0))
    before = tester.vehicle.store.saved
    for can_id, data in frames:
        CLOCK.now_s += 0.02
        for answer in tester.send(data, can_id):
            assert int(answer[:1], 16) <= 3  # single, first, consecutive, flow control
    assert tester.vehicle.store.saved == before
    assert tester.vehicle.clearings == 0
