"""Trouble codes over driving cycles: status byte, confirming, healing, erasing."""

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from monitor.base.config import load, shipped
from monitor.memory.codes import CODES, OF_MONITOR, TESTS
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import DtcStore
from tests.helpers.examples import inputs
from tests.helpers.memory.fault_store import CARB, code_of, confirmed, frame_of, heal, states


def test_every_test_of_the_monitor_sets_faults_that_have_codes() -> None:
    tested = [fault for faults in TESTS.values() for fault in faults]
    assert sorted(tested) == sorted(CODES)


@pytest.mark.parametrize("fault", CODES)
def test_a_code_is_pending_in_the_first_failing_cycle_confirmed_in_the_next(fault: str) -> None:
    store = DtcStore()
    assert (states(store), store.fault_flag) == ({}, False)
    for t_ns, state in ((7, "pending"), (3, "confirmed")):
        changed = store.fail(fault, t_ns)
        # THEN its codes, and no others, have the state; they keep it when it fails once more
        assert sorted(dtc.code for dtc in changed) == sorted(CODES[fault])
        store.fail(fault, t_ns + 2)
        assert states(store) == dict.fromkeys(CODES[fault], state)
        assert {dtc.t_ns for dtc in store.active} == {t_ns}
        assert store.fault_flag == (fault not in OF_MONITOR)
        store.start_driving_cycle()
        assert states(store) == dict.fromkeys(CODES[fault], state)


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


@pytest.mark.parametrize(
    ("fault", "other_test"),
    [
        ("biased_lean", "activity"),
        ("stuck_lean", "bias"),
        ("gain_low", "range"),
    ],
)
def test_a_passed_test_of_another_fault_leaves_a_code_alone(fault: str, other_test: str) -> None:
    store = DtcStore()
    store.fail(fault, 1)
    before = code_of(store, CODES[fault][0])
    store.complete(other_test)
    assert code_of(store, CODES[fault][0]) == before
    store.start_driving_cycle()
    store.complete(other_test)
    store.start_driving_cycle()
    assert states(store) == {CODES[fault][0]: "pending"}


def test_codes_stand_in_the_order_of_their_failing_and_an_undecided_pair_under_both_names() -> None:
    store = DtcStore()
    store.fail("slow_symmetric", 30, also=("transient",))
    store.fail("signal_missing", 10)
    store.fail("delay_symmetric", 20)
    assert [dtc.code for dtc in store.active] == ["U0100", "P015A", "P015B", "P0133"]
    assert (store.active[3].fault, store.active[3].also) == ("slow_symmetric", ("transient",))


def test_a_healed_code_is_erased_after_forty_warm_up_cycles() -> None:
    store = confirmed()
    heal(store)
    for _ in range(CARB.erase_warm_ups - 1):
        store.count_warm_up()
        store.start_driving_cycle()
        assert states(store) == {"P2195": "confirmed"}
    store.count_warm_up()
    assert states(store) == {"P2195": "confirmed"}  # until the cycle is over
    changed = store.start_driving_cycle()
    assert states(store) == {}
    assert "P2195" in {dtc.code for dtc in changed}
    gone = code_of(store, "P2195")
    assert (gone.fault, gone.also, gone.warm_ups) == ("", (), 0)
    assert gone.status == Status.FAILED_SINCE_CLEAR | Status.NOT_COMPLETED_THIS_CYCLE
    # and the next failure is a first one again
    store.fail("biased_lean", 1)
    assert states(store) == {"P2195": "pending"}


def test_warm_up_cycles_with_the_lamp_on_do_not_count_towards_erasing() -> None:
    store = confirmed()
    for _ in range(CARB.erase_warm_ups + 5):
        store.count_warm_up()
        store.start_driving_cycle()
    assert states(store) == {"P2195": "confirmed"}
    assert store.mil


def test_a_failure_starts_the_count_towards_erasing_anew() -> None:
    store = confirmed()
    heal(store)
    for _ in range(CARB.erase_warm_ups - 1):
        store.count_warm_up()
    store.fail("biased_lean", 1)
    assert not store.mil  # the first failing cycle after healing
    store.start_driving_cycle()
    store.complete("bias")
    store.count_warm_up()
    store.start_driving_cycle()
    assert states(store) == {"P2195": "confirmed"}


def test_erasing_a_code_leaves_a_later_failure_of_its_test_pending_under_its_name() -> None:
    store = confirmed()
    heal(store)
    store.fail("biased_lean", 1)
    for _ in range(CARB.erase_warm_ups):  # in drives too short for the test to complete
        store.start_driving_cycle()
        store.count_warm_up()
    store.start_driving_cycle()
    assert (states(store), code_of(store, "P2195").fault) == ({"P2195": "pending"}, "biased_lean")


def test_the_profile_sets_the_counts() -> None:
    eobd = shipped().eobd
    store = DtcStore(profile=eobd)
    for cycle in range(1, eobd.confirm_cycles + 1):
        store.start_driving_cycle()
        store.fail("gain_low", 1)
        assert store.mil == (cycle == eobd.confirm_cycles)
    assert eobd.confirm_cycles != CARB.confirm_cycles
    assert store.permanent == ()  # EOBD knows none
    short = replace(CARB, lamp_off_cycles=2, erase_warm_ups=1)
    store = confirmed(profile=short)
    heal(store, cycles=2)
    assert not store.mil
    store.count_warm_up()
    store.start_driving_cycle()
    assert states(store) == {}


def test_the_profile_is_chosen_by_name_and_its_counts_may_be_changed(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text('[obd]\nprofile = "eobd"\n[eobd]\nconfirm_cycles = 2\n')
    profile = load(file).profile
    assert (profile.confirm_cycles, profile.warm_up_degc) == (2, 70.0)
    assert load().profile == CARB


@dataclass
class Cycle:
    """What the history says of one driving cycle since the last clearing."""

    failed: bool = False
    completed: bool = False


class StatusByte(RuleBasedStateMachine):
    """Any sequence of events; the status byte must follow from the history of one code."""

    def __init__(self) -> None:
        super().__init__()
        self.store = DtcStore()
        self.history = [Cycle()]
        self.failing_now = False
        self.is_permanent = self.has_failed = False  # has failed: in this cycle, cleared or not

    @property
    def dtc(self) -> Dtc:
        return code_of(self.store, "P0133")

    @rule(fault=st.sampled_from(["slow_symmetric", "transient"]))
    def the_test_fails(self, fault: str) -> None:
        has_room = len(self.store.permanent) < CARB.permanent_most
        self.store.fail(fault, 1)
        self.store.freeze(frame_of("P0133", 1))
        self.history[-1].failed = self.history[-1].completed = self.failing_now = True
        self.has_failed = True
        self.is_permanent |= self.lamp()[1] and has_room

    @rule()
    def the_test_passes(self) -> None:
        self.store.complete("response")
        self.history[-1].completed, self.failing_now = True, False

    @rule(fault=st.sampled_from(sorted(set(CODES) - {"slow_symmetric", "transient"})))
    def another_test_fails(self, fault: str) -> None:
        self.store.fail(fault, 1)

    @rule(test=st.sampled_from(sorted(set(TESTS) - {"response"})))
    def another_test_passes(self, test: str) -> None:
        self.store.complete(test)

    @rule()
    def the_next_driving_cycle_begins(self) -> None:
        was_lit, passed = self.lamp()[1], self.history[-1].completed and not self.has_failed
        self.store.start_driving_cycle()
        self.history.append(Cycle())
        self.failing_now = self.has_failed = False
        # erased by the lamp's going out, or, once cleared, by a cycle in which its test passes
        self.is_permanent &= self.lamp()[1] or not (was_lit or passed)

    @rule(driving_cycles=st.integers(1, 3), passes=st.booleans())
    def it_is_driven(self, driving_cycles: int, passes: bool) -> None:
        for _ in range(driving_cycles):
            if passes:
                self.the_test_passes()
            self.the_next_driving_cycle_begins()

    @rule()
    def the_process_ends_and_begins_with_the_next_driving_cycle(self) -> None:
        self.store = DtcStore(self.store.saved)
        self.has_failed = self.history[-1].failed  # by the status byte alone
        self.the_next_driving_cycle_begins()

    @rule()
    def it_is_cleared(self) -> None:
        permanent, counts, ratios = self.store.permanent, self.store.counts, self.store.ratios
        self.store.clear()
        self.history = [Cycle()]
        self.failing_now = False
        assert self.store.permanent == permanent
        assert self.store.ratios == ratios
        assert self.store.counts.ignition_cycles == counts.ignition_cycles

    def lamp(self) -> tuple[bool, bool]:
        """Return whether the code was ever confirmed, and whether the lamp is on, by history."""
        was_confirmed = is_lit = False
        failed = passed = 0  # completed driving cycles in a row
        for number, cycle in enumerate(self.history, 1):
            is_over = number < len(self.history)
            if cycle.failed:
                failed, passed = failed + 1, 0
                was_confirmed |= failed == 2
                is_lit |= failed >= 2
            elif cycle.completed and is_over:
                failed, passed = 0, passed + 1
                is_lit &= passed < 3
        return was_confirmed, is_lit

    @invariant()
    def the_status_byte_follows_from_the_history(self) -> None:
        now, before = self.history[-1], [c for c in self.history[:-1] if c.completed]
        was_confirmed, is_lit = self.lamp()
        expected = {
            Status.TEST_FAILED: self.failing_now,
            Status.FAILED_THIS_CYCLE: now.failed,
            Status.PENDING: now.failed or bool(before and before[-1].failed),
            Status.CONFIRMED: was_confirmed,
            Status.NOT_COMPLETED_SINCE_CLEAR: not any(c.completed for c in self.history),
            Status.FAILED_SINCE_CLEAR: any(c.failed for c in self.history),
            Status.NOT_COMPLETED_THIS_CYCLE: not now.completed,
            Status.WARNING_INDICATOR: is_lit,
        }
        assert {bit: bool(self.dtc.status & bit) for bit in Status} == expected

    @invariant()
    def what_goes_with_a_code_agrees_with_it(self) -> None:
        store = self.store
        assert ("P0133" in store.freeze_frames) == (self.dtc.state is not None)
        assert store.mil == any(d.status & Status.WARNING_INDICATOR for d in store.all)
        lit = {d.code for d in store.all if d.status & Status.WARNING_INDICATOR}
        assert lit <= set(store.permanent) or len(store.permanent) == CARB.permanent_most
        assert ("P0133" in store.permanent) == self.is_permanent
        assert store.completed_since_clear("response") or not self.dtc.state


StatusByte.TestCase.settings = inputs(150, stateful_step_count=40)
TestStatusByte = StatusByte.TestCase
