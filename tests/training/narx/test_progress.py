"""The progress of a training: best error so far and time left."""

import io

from training.cli.console.progress import LINE_S, Progress
from training.cli.console.progress_bar import Bar
from training.narx.search.stages import EPOCHS, HORIZONS

HORIZON = 1


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_without_a_terminal_a_line_tells_best_error_and_time_left() -> None:
    # GIVEN a training whose progress goes to a file, with ten minutes at most
    clock, out = Clock(), io.StringIO()
    with Bar(10.0, out, clock) as bar:
        bar.update(0, HORIZON, 0, 0.9)
        assert out.getvalue() == ""
        # WHEN half a minute has passed
        clock.now_s = LINE_S
        bar.update(0, HORIZON, 1, 0.5)
    # THEN one line tells the best error, and at most the rest of the budget
    (line,) = out.getvalue().splitlines()
    assert "best free run 0.500" in line
    assert "about 9:30 left" in line


def test_no_error_is_told_while_no_free_run_stays_finite() -> None:
    clock, out = Clock(), io.StringIO()
    with Bar(10.0, out, clock) as bar:
        bar.update(0, HORIZON, 0, float("inf"))
        clock.now_s = LINE_S
        bar.update(0, HORIZON, 1, float("inf"))
    assert out.getvalue() == f"o2train: horizon {HORIZON}, about 9:30 left\n"


def test_the_time_left_follows_the_pace_and_never_exceeds_the_budget() -> None:
    clock = Clock()
    with Bar(10.0, io.StringIO(), clock) as bar:
        assert bar.left_s == 600.0
        for epoch in range(5):
            clock.now_s = 0.1 * epoch
            bar.update(0, HORIZON, epoch, 1.0)
        rest = EPOCHS * (1 + len(HORIZONS)) - 5
        assert abs(bar.left_s - 0.1 * rest) < 1e-6
        clock.now_s = 700.0
        assert bar.left_s == 0.0


def test_steps_of_unknown_length_are_lines_where_there_is_no_terminal() -> None:
    clock, out = Clock(), io.StringIO()
    with Progress(out, clock, unit="step") as bar:
        for clock.now_s, text in ((1.0, "naming"), (40.0, "adding"), (50.0, "verifying")):
            bar.step(text)
    assert out.getvalue() == "o2train: adding\n"
