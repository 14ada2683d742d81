"""The fault detection counter of ISO 14229-1."""

from hypothesis import given
from hypothesis import strategies as st

from monitor.memory.debounce import FAILED, PASSED, Debounce

steps = st.lists(st.tuples(st.booleans(), st.integers(1, 127)), max_size=60)


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
