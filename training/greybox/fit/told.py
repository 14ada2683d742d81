"""How a fit tells its progress: rounds done and the best error so far."""

from collections.abc import Callable
from dataclasses import dataclass, field

Report = Callable[[float, float], None]  # share done, 0 to 1; best RMSE so far in phi


def nobody(_share: float, _rmse: float) -> None:
    """Tell nobody."""


@dataclass
class Told:
    """Counts the rounds of a fit.

    rounds : of the whole fit; a fit that ends early has fewer
    """

    report: Report = nobody
    rounds: int = 1
    _done: int = 0
    _best: float = field(default=float("inf"))

    def round_done(self, rmse: float) -> None:
        """Count one more round that ended with this error."""
        self._done += 1
        self._best = min(self._best, rmse)
        self.report(min(self._done / self.rounds, 1.0), self._best)
