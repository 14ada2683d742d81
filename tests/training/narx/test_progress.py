"""The progress of a training: best error so far and time left."""

import io
from types import SimpleNamespace

import numpy as np
import pytest

from training.cli.progress import LINE_S, Budget, Progress
from training.narx.work import PER_MINUTE


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize(
    ("rmse", "told"), [(0.5, "570 s left, best error 0.5000"), (np.inf, "570 s left")]
)
def test_without_a_terminal_a_line_tells_best_error_and_time_left(rmse: float, told: str) -> None:
    # GIVEN a training whose progress goes to a file, with ten minutes of work
    clock, out = Clock(), io.StringIO()
    with Budget(10.0, out, clock) as bar:
        bar.spend(0.25 * PER_MINUTE)
        bar.tried(SimpleNamespace(rmse=rmse))  # type: ignore[arg-type]
        assert out.getvalue() == ""
        # WHEN half a minute has brought the work of half a minute
        clock.now_s = LINE_S
        bar.spend(0.25 * PER_MINUTE)
    # THEN one line tells the best error that is finite, and the rest of the budget
    assert out.getvalue() == f"training: 5 % done, {told}\n"


def test_the_time_left_follows_the_pace_and_ends_at_0() -> None:
    clock, out = Clock(), io.StringIO()
    with Budget(10.0, out, clock) as bar:
        # WHEN a busy machine has done two minutes of work in six THEN the rest takes 24
        for clock.now_s, minutes in ((360.0, 2.0), (500.0, 9.0)):
            bar.spend(minutes * PER_MINUTE)
    assert out.getvalue().splitlines() == [
        "training: 20 % done, 1440 s left",
        "training: 100 % done, 0 s left",
    ]


def test_steps_of_unknown_length_are_lines_where_there_is_no_terminal() -> None:
    clock, out = Clock(), io.StringIO()
    with Progress(out, clock, unit="step") as bar:
        for clock.now_s, text in ((1.0, "naming"), (40.0, "adding"), (50.0, "verifying")):
            bar.step(text)
    assert out.getvalue() == "o2train: adding\n"
