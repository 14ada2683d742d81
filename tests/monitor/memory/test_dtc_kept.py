"""What is kept beside the codes: permanent codes, freeze frames, readiness, ratios, counts."""

from dataclasses import replace

import pytest

from monitor.memory import obd_records
from monitor.memory.codes import BEHIND, TESTS
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.obd_records import Counts, FreezeFrame
from tests.helpers.memory.fault_store import CARB, confirmed, failing, frame_of, heal


def test_clearing_leaves_permanent_codes_ratios_and_ignition_cycles() -> None:
    store = confirmed()
    store.freeze(FreezeFrame("P2195", 1, {"engine_speed_rpm": 2000.0}))
    store.report([obd_records.TestResult("bias", "offset", 0.1, -0.05, 0.05)])
    store.counts.ignition_cycles += 1
    store.count_general_denominator()
    store.count_judged("bias")
    store.count_warm_up()
    store.drive(60.0, 1.0)
    ratios = store.ratios
    assert store.counts == Counts(1, 1, 1, 1.0, 1.0, 60.0, 60.0)
    assert [r.quantity for r in store.results] == ["offset"]
    changed = store.clear()
    assert {d.code for d in changed} == {"P2195"}
    assert all(dtc == Dtc(dtc.code) for dtc in store.all)
    assert not store.mil
    assert not store.freeze_frames
    assert store.results == ()
    assert not any(store.completed_since_clear(test) for test in TESTS)
    assert store.permanent == ("P2195",)
    assert store.ratios == ratios
    assert store.counts == Counts(ignition_cycles=1, general_denominator=1)
    assert store.clearings == 1


def test_what_passed_before_clearing_completes_no_code_after_it() -> None:
    store = DtcStore()
    store.complete("activity")
    store.clear()
    # P2195 can be set by both tests: each must pass again
    assert store.complete("bias") == []
    assert {dtc.code for dtc in store.complete("activity")} >= {"P2195", "P2196"}


def test_a_permanent_code_of_a_continuous_test_needs_a_real_drive_to_go() -> None:
    store = confirmed("signal_missing")
    store.clear()
    store.start_driving_cycle()
    store.complete("communication")
    store.start_driving_cycle()
    assert store.permanent == ("U0100",)  # it passes as soon as the ignition is on
    store.complete("communication")
    store.count_general_denominator()
    store.start_driving_cycle()
    assert store.permanent == ()


def test_no_more_permanent_codes_are_kept_than_the_profile_says() -> None:
    store = DtcStore(profile=replace(CARB, permanent_most=2))
    for fault in ("gain_low", "biased_lean", "not_ready"):
        for _ in range(2):
            store.start_driving_cycle()
            store.fail(fault, 1)
    assert store.permanent == ("P2A00", "P2195")
    # and one that is kept may change its fault
    store.start_driving_cycle()
    store.fail("stuck_lean", 1)
    assert store.saved.permanent["P2195"] == "stuck_lean"


def test_the_signals_of_the_first_failing_are_replaced_by_those_of_the_confirming() -> None:
    store = DtcStore()
    for cycle, expected in ((1, 11), (2, 21), (3, 21)):
        store.start_driving_cycle()
        failing(store, "gain_low", 10 * cycle + 1)
        store.freeze(frame_of("P2A00", 10 * cycle + 2))  # named anew in the same cycle
        assert store.freeze_frames["P2A00"].t_ns == expected


def test_confirmed_codes_come_first_among_the_freeze_frames_then_the_earlier_ones() -> None:
    store = DtcStore()
    failing(store, "biased_rich", 1)
    failing(store, "gain_low", 2)
    failing(store, "slow_symmetric", 3)
    assert list(store.freeze_frames) == ["P2196", "P2A00", "P0133"]
    store.start_driving_cycle()
    failing(store, "slow_symmetric", 4)
    assert list(store.freeze_frames) == ["P0133", "P2196", "P2A00"]


def test_a_test_is_ready_when_it_has_passed_or_failed_since_clearing() -> None:
    store = DtcStore()
    store.complete("bias")
    store.fail("gain_low", 1)
    ready = [test for test in TESTS if store.completed_since_clear(test)]
    assert ready == ["response", "bias"]
    store.start_driving_cycle()
    assert [test for test in TESTS if store.completed_since_clear(test)] == ready


def test_a_numerator_counts_once_in_a_driving_cycle_also_over_a_clearing() -> None:
    store = DtcStore()
    assert store.count_judged("response")
    assert not store.count_judged("response")
    store.clear()
    assert not store.count_judged("response")
    store.start_driving_cycle()
    assert store.count_judged("response")
    numerators = {test: 0 for test in TESTS if test != "memory"}  # a self-test has no ratio
    assert {r.test: r.numerator for r in store.ratios} == numerators | {"response": 2}


def test_the_denominators_count_once_in_a_driving_cycle() -> None:
    store = DtcStore()
    for _ in range(3):
        store.start_driving_cycle()
        store.count_general_denominator()
        store.count_general_denominator()
    assert store.counts.general_denominator == 3
    assert {r.denominator for r in store.ratios} == {3}


def test_a_code_that_keeps_a_test_from_judging_pauses_its_ratio() -> None:
    store = DtcStore()
    store.fail("signal_missing", 1)
    store.count_general_denominator()
    assert not store.count_judged("response")
    assert store.count_judged("communication")
    paused = {r.test for r in store.ratios if not r.denominator}
    assert paused == {"response", "bias", "activity", *BEHIND}
    assert store.counts.general_denominator == 1


def test_a_code_of_a_test_that_needs_driving_pauses_no_ratio_nor_does_one_that_is_gone() -> None:
    store = DtcStore()
    store.fail("gain_low", 1)
    assert store.count_judged("response")
    store = DtcStore()
    store.fail("signal_missing", 1)
    for _ in range(2):
        store.start_driving_cycle()
        store.complete("communication")
    assert store.count_judged("response")


@pytest.mark.parametrize(("numerator", "denominator"), [(65534, 9), (8, 65534)])
def test_a_counter_at_its_end_is_halved_with_its_partner(numerator: int, denominator: int) -> None:
    store = DtcStore(Saved(ratios=(obd_records.Ratio("bias", numerator, denominator),)))
    store.count_judged("bias")
    store.count_general_denominator()
    ratio = next(r for r in store.ratios if r.test == "bias")
    full = numerator == 65534
    assert (ratio.numerator, ratio.denominator) == ((32767, 5) if full else (4, 32767))


def test_what_is_driven_counts_since_clearing_and_with_the_lamp_on() -> None:
    store = confirmed()
    store.clear()
    store.drive(100.0, 2.0)
    assert store.counts == Counts(distance_since_clear_km=2.0, engine_run_since_clear_s=100.0)
    store = confirmed()
    store.drive(100.0, 2.0)
    store.fail("gain_low", 1)  # another code, the lamp is on already
    store.drive(50.0, 1.0)
    store.fail("biased_lean", 1)
    assert store.counts == Counts(0, 0, 0, 3.0, 3.0, 150.0, 150.0)
    heal(store)
    store.fail("slow_symmetric", 1)  # a pending code lights no lamp
    store.drive(50.0, 1.0)  # with the lamp off what was driven with it stays
    assert store.counts == Counts(0, 0, 0, 4.0, 3.0, 150.0, 200.0)
    for _ in range(2):  # and begins anew with the lamp; P2195 fails in two more cycles
        store.start_driving_cycle()
        store.fail("biased_lean", 1)
    assert store.counts == Counts(distance_since_clear_km=4.0, engine_run_since_clear_s=200.0)
