"""Debounce counter and trouble codes over driving cycles."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.config import shipped
from monitor.debounce import FAILED, PASSED, Debounce
from monitor.dtc import CODES, FRESH, TESTS, Dtc, DtcStore, Status

steps = st.lists(st.tuples(st.booleans(), st.integers(1, 127)), max_size=60)


def code_of(store: DtcStore, code: str) -> Dtc:
    return next(dtc for dtc in store.all if dtc.code == code)


def states(store: DtcStore) -> dict[str, str | None]:
    return {dtc.code: dtc.state for dtc in store.active}


# Debounce


@given(steps)
def test_the_counter_stays_within_iso_14229(results: list[tuple[bool, int]]) -> None:
    counter = Debounce()
    for failed, by in results:
        counter = counter.step(failed=failed, by=by)
        assert PASSED <= counter.count <= FAILED
        assert not (counter.failed and counter.passed)


@given(steps, st.booleans(), st.integers(1, 127))
def test_a_failed_result_never_lowers_the_counter_and_a_passed_one_never_raises_it(
    results: list[tuple[bool, int]], failed: bool, by: int
) -> None:
    before = Debounce()
    for f, b in results:
        before = before.step(failed=f, by=b)
    after = before.step(failed=failed, by=by)
    end = FAILED if failed else PASSED
    assert after.count == end or (after.count > before.count) == failed
    assert after.count != before.count or before.count == end


@given(st.booleans(), st.integers(1, 127))
def test_a_test_matures_after_exactly_the_configured_steps(failed: bool, by: int) -> None:
    needed = -(-(FAILED if failed else -PASSED) // by)
    counter = Debounce()
    for i in range(1, needed + 3):
        counter = counter.step(failed=failed, by=by)
        assert (counter.failed if failed else counter.passed) == (i >= needed)
        assert not (counter.passed if failed else counter.failed)


@given(steps, st.booleans(), st.integers(1, 127))
def test_the_opposite_result_restarts_from_zero(
    results: list[tuple[bool, int]], failed: bool, by: int
) -> None:
    counter = Debounce()
    for f, b in results:
        counter = counter.step(failed=f, by=b)
    if (counter.count > 0) != failed:
        assert counter.step(failed=failed, by=by) == Debounce().step(failed=failed, by=by)


def test_the_counter_ends_where_iso_14229_says() -> None:
    assert (FAILED, PASSED) == (127, -128)


def test_a_long_healthy_time_does_not_slow_detection_down() -> None:
    counter = Debounce()
    for _ in range(1000):
        counter = counter.step(failed=False, by=64)
    assert counter.step(failed=True, by=64).step(failed=True, by=64).failed


def test_alternating_results_never_mature() -> None:
    counter = Debounce()
    for i in range(100):
        counter = counter.step(failed=i % 2 == 0, by=64)
        assert not counter.failed
        assert not counter.passed


# Codes


def test_every_test_of_the_monitor_sets_faults_that_have_codes() -> None:
    tested = [fault for faults in TESTS.values() for fault in faults]
    assert sorted(tested) == sorted(CODES)


@pytest.mark.parametrize("fault", CODES)
def test_a_code_is_pending_in_the_first_failing_driving_cycle_and_confirmed_in_the_next(
    fault: str,
) -> None:
    store = DtcStore()
    # GIVEN a new store
    assert states(store) == {}
    assert not store.fault_flag
    # WHEN the fault's test fails
    changed = store.fail(fault, t_ns=7)
    # THEN its codes, and no others, are pending
    assert sorted(dtc.code for dtc in changed) == sorted(CODES[fault])
    assert states(store) == dict.fromkeys(CODES[fault], "pending")
    assert store.fault_flag
    # and it stays so when the test fails again in the same driving cycle
    store.fail(fault, t_ns=9)
    assert states(store) == dict.fromkeys(CODES[fault], "pending")
    assert {dtc.t_ns for dtc in store.active} == {7}
    # WHEN it fails in the next driving cycle, too
    store.start_driving_cycle()
    assert states(store) == dict.fromkeys(CODES[fault], "pending")
    store.fail(fault, t_ns=3)
    # THEN the codes are confirmed
    assert states(store) == dict.fromkeys(CODES[fault], "confirmed")
    assert {dtc.t_ns for dtc in store.active} == {3}


def test_the_status_byte_through_two_failing_driving_cycles() -> None:
    store = DtcStore()

    def status() -> Status:
        return code_of(store, "P0133").status

    assert status() == FRESH == 0x50
    store.fail("slow_symmetric", 1)
    assert status() == 0x27  # failed now, this cycle, since clear; pending
    store.start_driving_cycle()
    assert status() == 0x64  # pending, not completed this cycle, failed since clear
    store.fail("slow_symmetric", 1)
    assert status() == 0xAF  # confirmed, lamp requested
    store.complete("response")
    assert status() == 0xAE  # the test passes now, but it has failed this cycle
    store.start_driving_cycle()
    assert status() == 0xEC


def test_a_completed_test_without_a_fault_clears_only_the_completion_bits() -> None:
    store = DtcStore()
    # P2195 and P2196 can be set by the test for an offset and by the one for a frozen signal
    assert store.complete("bias") == []
    changed = store.complete("activity")
    assert {dtc.code for dtc in changed} == {"P2195", "P2196"}
    assert {int(dtc.status) for dtc in changed} == {0x00}
    assert store.complete("activity") == []  # nothing changes twice
    # in the next driving cycle both must pass again
    store.start_driving_cycle()
    assert store.complete("activity") == []


def test_a_cycle_in_which_the_test_does_not_complete_neither_confirms_nor_heals() -> None:
    store = DtcStore()
    store.fail("gain_low", 1)
    for _ in range(5):
        store.start_driving_cycle()
    assert states(store) == {"P2A00": "pending"}
    store.start_driving_cycle()
    store.fail("gain_low", 1)
    assert states(store) == {"P2A00": "confirmed"}


def test_a_pending_code_goes_after_a_driving_cycle_that_passes() -> None:
    store = DtcStore()
    store.fail("delay_rich_to_lean", 1)
    store.start_driving_cycle()
    store.complete("response")
    assert states(store) == {"P015A": "pending"}  # until the cycle is over
    store.start_driving_cycle()
    assert states(store) == {}
    # and the next failure is a first one again
    store.fail("delay_rich_to_lean", 1)
    assert states(store) == {"P015A": "pending"}


def test_the_lamp_goes_out_after_three_passing_driving_cycles_in_a_row() -> None:
    store = DtcStore()
    for _ in range(2):
        store.fail("biased_lean", 1)
        store.start_driving_cycle()
    for cycle in range(1, shipped().carb.lamp_off_cycles + 1):
        assert code_of(store, "P2195").status & Status.WARNING_INDICATOR, cycle
        store.complete("bias")
        store.start_driving_cycle()
    healed = code_of(store, "P2195")
    assert not healed.status & Status.WARNING_INDICATOR
    assert healed.state == "confirmed"  # the code itself is kept


def test_a_failing_cycle_starts_the_count_towards_healing_anew() -> None:
    store = DtcStore()
    for _ in range(2):
        store.fail("biased_lean", 1)
        store.start_driving_cycle()
    for passes in (True, True, False, True, True):
        if passes:
            store.complete("bias")
        else:
            store.fail("biased_lean", 1)
        store.start_driving_cycle()
    assert code_of(store, "P2195").status & Status.WARNING_INDICATOR
    store.complete("bias")
    store.start_driving_cycle()
    assert not code_of(store, "P2195").status & Status.WARNING_INDICATOR


def test_a_cycle_without_a_completed_test_does_not_count_towards_healing() -> None:
    store = DtcStore()
    for _ in range(2):
        store.fail("biased_lean", 1)
        store.start_driving_cycle()
    for completes in (True, False, True, False):
        if completes:
            store.complete("bias")
        store.start_driving_cycle()
    assert code_of(store, "P2195").status & Status.WARNING_INDICATOR


@pytest.mark.parametrize(
    ("fault", "other_test"),
    [("biased_lean", "activity"), ("stuck_lean", "bias"), ("gain_low", "range"),
     ("out_of_range", "response"), ("stuck_at_one", "ready"), ("not_ready", "activity")],
)  # fmt: skip
def test_a_passed_test_of_another_fault_leaves_a_shared_code_alone(
    fault: str, other_test: str
) -> None:
    store = DtcStore()
    store.fail(fault, 1)
    before = code_of(store, CODES[fault][0])
    store.complete(other_test)
    assert code_of(store, CODES[fault][0]) == before
    store.start_driving_cycle()
    store.complete(other_test)
    store.start_driving_cycle()
    assert states(store) == {CODES[fault][0]: "pending"}


@given(st.lists(st.sampled_from(["fail", "complete", "next"]), max_size=40))
def test_the_bits_of_the_status_byte_agree_with_each_other(events: list[str]) -> None:
    store, seen_failed = DtcStore(), False
    for event in events:
        if event == "fail":
            store.fail("slow_symmetric", 1)
            seen_failed = True
        elif event == "complete":
            store.complete("response")
        else:
            store.start_driving_cycle()
        dtc = code_of(store, "P0133")
        status = dtc.status
        assert bool(status & Status.FAILED_SINCE_CLEAR) == seen_failed
        if status & Status.TEST_FAILED:
            assert status & Status.FAILED_THIS_CYCLE
        if status & Status.FAILED_THIS_CYCLE:
            assert status & Status.PENDING
            assert not status & Status.NOT_COMPLETED_THIS_CYCLE
        if status & (Status.PENDING | Status.CONFIRMED):
            assert not status & Status.NOT_COMPLETED_SINCE_CLEAR
        if status & Status.WARNING_INDICATOR:
            assert status & Status.CONFIRMED
        assert 0 <= status <= 0xFF


def test_an_undecided_pair_carries_the_other_name() -> None:
    store = DtcStore()
    store.fail("delay_rich_to_lean", 1, also=("slow_rich_to_lean",))
    assert store.active[0].also == ("slow_rich_to_lean",)
    assert store.active[0].fault == "delay_rich_to_lean"


def test_codes_stand_in_the_order_of_their_failing() -> None:
    store = DtcStore()
    store.fail("slow_symmetric", 30)
    store.fail("signal_missing", 10)
    store.fail("delay_symmetric", 20)
    assert [dtc.code for dtc in store.active] == ["U0100", "P015A", "P015B", "P0133"]
