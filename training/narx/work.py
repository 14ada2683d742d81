"""Counted work: what a budget of minutes buys, the same on every machine and beside other work.

An epoch over n samples of a network with w weights counts n w (1 + w / 1000): the sensitivities
grow with w, the normal equations with its square.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")

PER_MINUTE: Final = 5e9  # on one core of a 2.1 GHz Xeon, validation included
SQUARE_WEIGHTS: Final = 1000.0  # weights at which the normal equations cost as much as the rest


def of_epoch(n_samples: int, n_weights: int) -> float:
    """Return the work of one epoch."""
    return n_samples * n_weights * (1.0 + n_weights / SQUARE_WEIGHTS)


class Work:
    """A budget of counted work, and a wall limit that may end it early.

    wall_end_s : ``time.monotonic()`` after which no further epoch begins
    tell : called with the work of every epoch, also of parts of this budget
    """

    def __init__(
        self,
        limit: float = np.inf,
        wall_end_s: float = np.inf,
        tell: Callable[[float], None] = lambda _: None,
    ) -> None:
        self.limit, self.wall_end_s, self._tell = limit, wall_end_s, tell
        self.spent, self.is_used_up, self.ended_by_wall = 0.0, False, False

    @classmethod
    def of_minutes(
        cls,
        minutes: float,
        wall_minutes: float | None = None,
        tell: Callable[[float], None] = lambda _: None,
    ) -> "Work":
        """Return the work that one core does in about so many minutes."""
        wall = np.inf if wall_minutes is None else time.monotonic() + 60.0 * wall_minutes
        return cls(PER_MINUTE * minutes, wall, tell)

    @property
    def left(self) -> float:
        """Return the work that is left, 0 or more."""
        return max(self.limit - self.spent, 0.0)

    def is_over(self) -> bool:
        """Return whether no further epoch may begin."""
        if time.monotonic() > self.wall_end_s:
            self.ended_by_wall = True
        return self.ended_by_wall or self.is_used_up or self.spent >= self.limit

    def up_to(self, limit: float) -> "Work":
        """Return a budget of its own within this one, to be joined again."""
        return Work(min(limit, self.left), self.wall_end_s, self._tell)

    def join(self, *parts: "Work") -> None:
        """Count what the parts have spent."""
        self.spent += sum(part.spent for part in parts)
        self.ended_by_wall |= any(part.ended_by_wall for part in parts)

    def side_by_side(
        self, job: Callable[[Item, "Work"], Result], items: Sequence[Item], threads: int
    ) -> list[Result]:
        """Return the results of a job on each item, which has an equal part of what is left."""
        parts = [self.up_to(self.left / len(items)) for _ in items]
        with ThreadPoolExecutor(max(1, threads)) as pool:
            found = list(pool.map(job, items, parts))
        self.join(*parts)
        return found

    def allows(self, epoch: float) -> bool:
        """Return whether an epoch of this work may begin; the first that may not ends the budget.

        epoch : from ``of_epoch``
        """
        self.is_used_up |= self.spent + epoch > self.limit
        return not self.is_over()

    def begins(self, epoch: float) -> bool:
        """Count an epoch of this work; return False if the budget allows none."""
        if not self.allows(epoch):
            return False
        self.spent += epoch
        self._tell(epoch)
        return True
