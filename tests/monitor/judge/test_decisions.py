"""Decisions about one sensor in one driving cycle, from findings that are made here."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from monitor.base import config
from monitor.judge.catalyst.rule import Claim
from monitor.judge.decision.decisions import Decisions
from monitor.judge.decision.window_facts import Facts
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.electrical.suite import RETURNS
from monitor.judge.findings import DtcChanged
from monitor.judge.limits import Limits
from monitor.judge.response.movement import DEAD, Moved
from monitor.judge.response.rule import Estimates, Response
from monitor.judge.trust import Trust
from monitor.judge.window import Outcome, Window
from monitor.memory.dtc import Status
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.replay import Setup

SETTINGS = config.shipped()
WINDOW = Window(0, 0, 5_000_000_000, np.ones(50), np.ones(50), np.ones((50, 1)))
ALIVE, GONE = Moved(None, 0.0, 0.0), Moved(DEAD, 12.0, 0.0)


def decisions(setup: Setup, trust: Trust | None = None) -> Decisions:
    card, store = setup.model.card, DtcStore()
    store.start_driving_cycle()
    limits = Limits.from_card(card, SETTINGS, "shipped")
    limits = replace(limits, trust=trust or limits.trust)
    return Decisions(limits, SETTINGS, card, store, {})


def facts(
    outcome: Outcome = "passed",
    *,
    offset: float = 0.0,
    moved: Moved = ALIVE,
    no_evidence: bool = False,
) -> Facts:
    response = Response(outcome, column=0, statistics=Estimates(0.02, 0.0, "healthy"))
    return Facts(offset, 0.01, no_evidence, offset, response, moved)


def judged(given: Decisions, *windows: Facts) -> Decisions:
    for each in windows:
        list(given.window(WINDOW, each))
    return given


def failing(given: Decisions) -> set[str]:
    return {dtc.fault for dtc in given.store.all if dtc.status & Status.TEST_FAILED}


def codes(changes: Iterable[object]) -> list[str]:
    return [each.dtc.code for each in changes if isinstance(each, DtcChanged)]


def test_the_oxygen_balance_names_the_upstream_sensor_whatever_the_bias_rule_says(
    setup: Setup,
) -> None:
    # GIVEN a catalyst whose balance says twice that the upstream sensor reads lean
    given = decisions(setup)
    for _ in range(2):
        list(given.behind("balance", Claim("failed", "balance_rich"), 1))
    bias = Claim("failed", "biased_lean")
    assert codes(given.behind("bias", bias, 1)) == ["P2195"]
    # WHEN the offsets of many windows are healthy ones by the bias rule
    judged(given, *[facts()] * 10)
    # THEN the test of the offset has failed, its code fails still, and is not set anew
    assert given.outcomes["bias"] == "failed"
    assert "biased_lean" in failing(given)
    assert codes(given.behind("bias", bias, 2)) == []
    # AND once the balance holds again, the bias rule decides
    for _ in range(4):
        list(given.behind("balance", Claim("passed"), 3))
    judged(given, *[facts()] * 10)
    assert given.outcomes["bias"] == "passed"


def test_a_dead_sensor_has_failed_the_response_test(setup: Setup) -> None:
    given = judged(decisions(setup), *[facts(moved=GONE)] * 3)
    assert failing(given) == {DEAD}
    assert given.outcomes["response"] == "failed"


def test_a_sensor_that_may_be_dead_has_not_passed_the_response_test(setup: Setup) -> None:
    doubtful = Moved(None, SETTINGS.movement.doubt, 0.0)
    given = judged(decisions(setup), *[facts()] * 3, facts(moved=doubtful))
    assert given.outcomes["response"] == "undecided"
    assert judged(given, facts()).outcomes["response"] == "passed"


@pytest.mark.parametrize("result", [RETURNS, TickResult("activity", True, "stuck_lean")])
def test_a_fault_that_a_healthy_drive_showed_sets_no_code_whichever_test_finds_it(
    result: TickResult, setup: Setup
) -> None:
    for false, wanted in ({}, 1), ({result.fault: 1}, 0):
        given = decisions(setup, Trust(drives=3, found={"transient": 3}, false=false))
        changes = [each for _ in range(2) for each in given.electrical(result, 1)]
        assert len(codes(changes)) == wanted


def test_a_signal_missing_in_a_healthy_drive_is_told_when_missing_again(setup: Setup) -> None:
    trust = Trust(drives=3, found={"transient": 3}, false={"signal_missing": 1})
    missing = TickResult("communication", True, "signal_missing")
    assert codes(decisions(setup, trust).electrical(missing, 1)) == ["U0100"]
    assert (trust.untold, trust.untested) == (frozenset(), ())


def test_jumps_to_one_value_complete_the_response_test(setup: Setup) -> None:
    given = decisions(setup)
    assert codes(given.electrical(RETURNS, 1)) == ["P2A00"]
    assert given.completed
    assert given.outcomes["response"] == "failed"


def test_a_vehicle_s_reference_learns_from_no_window_that_counts_for_nothing(setup: Setup) -> None:
    # GIVEN as many windows in which the reading stands still, elsewhere, as windows that count
    enough = SETTINGS.bias.reference_windows
    still = facts("inconclusive", offset=0.03, no_evidence=True)
    given = judged(decisions(setup), *[facts(), still] * enough)
    # THEN the reference learns the offset of those that count
    assert given.seen is not None
    assert given.seen.offset == 0.0
    # AND nothing from a drive in which too few count, or one was suspicious, or that has a code
    assert judged(decisions(setup), *[facts(), still] * (enough - 1)).seen is None
    assert (
        judged(decisions(setup), *[facts()] * enough, facts("failed"), *[facts()] * 5).seen is None
    )
    given = judged(decisions(setup), *[facts()] * enough)
    given.store.fail("signal_missing", 1)
    assert given.seen is None
