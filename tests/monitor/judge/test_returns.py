"""A reading that jumps to one value again and again is intermittent."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.electrical.suite import RETURNS, ElectricalTests, ReturnTest
from monitor.judge.limits import in_unit
from monitor.model.card import Channel
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model

JUMP, NEEDED = 0.03, 10
NAMES = ("lambda_measured", "fuel_cut")
OUTPUT = Channel(NAMES[0], "-", 0.7, 1.4, 0.7, 1.4)


def decisions(measured: FloatArray, *, blocks: int = 1, burning: bool = True) -> list[int]:
    test, found, at = ReturnTest(JUMP, NEEDED), [], 0
    for part in np.array_split(measured, blocks):
        found += [at + k for k in test.push(part, np.full(len(part), burning))]
        at += len(part)
    return found


def live(n: int = 3000) -> FloatArray:
    rng = np.random.default_rng(7)
    return 1.0 + 0.05 * np.sin(np.arange(n) / 7.0) + 0.002 * rng.standard_normal(n)


def with_drops(measured: FloatArray, values: FloatArray | list[float]) -> FloatArray:
    """Return readings that drop to the values for half a second, every ten seconds."""
    dropped = measured.copy()
    for k, value in enumerate(values):
        dropped[100 * k + 50 : 100 * k + 55] = value
    return dropped


def returns_in(tests: ElectricalTests, values: FloatArray) -> list[TickResult]:
    good, burning = np.zeros(values.shape, np.uint8), np.full(len(values), True)
    found, *_ = tests.push(values, good, burning)
    return [result for _, result in found if result == RETURNS]


def test_the_tenth_drop_to_exactly_one_value_decides_once() -> None:
    assert decisions(with_drops(live(), [0.9] * 25)) == [100 * 9 + 55]


def test_drops_to_values_that_differ_are_a_mixture_that_moves() -> None:
    values = np.random.default_rng(8).uniform(0.8, 0.9, 25)
    assert not decisions(with_drops(live(), values))
    every_second = np.where(np.arange(25) % 2, values, 0.9)  # no majority
    assert not decisions(with_drops(live(), every_second))


def test_rests_without_a_jump_count_for_nothing() -> None:
    near = 0.99 + 0.01 * np.sin(np.arange(3000) / 7.0)  # less than a jump around it
    assert not decisions(with_drops(near, [0.99] * 25))


def test_a_reading_of_air_is_no_default_value_unless_fuel_burns() -> None:
    cuts = with_drops(live(), [1.36] * 25)
    assert not decisions(cuts, burning=False)
    assert decisions(cuts)


def test_where_nothing_tells_a_fuel_cut_no_value_is_a_default_value() -> None:
    tests = ElectricalTests(config.shipped(), NAMES[:1], OUTPUT, 0.1)
    assert returns_in(tests, with_drops(live(), [1.36] * 25)[:, np.newaxis]) == []


def test_drops_that_go_on_after_a_tester_cleared_the_codes_are_found_again() -> None:
    # GIVEN a sensor that drops to one value again and again, and a test that has found it
    tests = ElectricalTests(config.shipped(), NAMES, OUTPUT, 0.1)
    values = np.column_stack([with_drops(live(), [0.9] * 25), np.zeros(3000)])
    assert returns_in(tests, values) == [RETURNS]
    # WHEN it goes on THEN it is not told anew, unless the codes were cleared
    assert returns_in(tests, values) == []
    tests.forget()
    assert returns_in(tests, values) == [RETURNS]


@given(st.integers(1, 400))
def test_evidence_does_not_depend_on_where_blocks_begin(blocks: int) -> None:
    dropped = with_drops(live(), [0.9] * 25)
    assert decisions(dropped, blocks=blocks) == decisions(dropped)


@pytest.mark.parametrize("unit", [1.0, 1e-4, 1e3])
def test_a_reading_moves_in_whatever_unit_it_is(unit: float) -> None:
    card = Model.load(shipped_model()).card
    card = replace(card, transform="none", output=Channel("y", "V", 0.0, unit, 0.0, unit))
    tests = ElectricalTests(in_unit(config.shipped(), card), ("y",), card.output, 0.1)
    found, *_ = tests.push(unit * live()[:, None] / 2, np.zeros((3000, 1), np.uint8), live() > 0.0)
    assert {(each.test, each.failed) for _, each in found} >= {("activity", False)}
    assert not any(each.failed for _, each in found)
