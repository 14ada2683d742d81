"""The progress bar of a training with several starts at once, on the standard error."""

from threading import Lock
from types import TracebackType

from tqdm import tqdm

from training.narx.stages import EPOCHS
from training.narx.structure import Try


class Bar:
    """Epochs of all starts; a stage that ends early counts with all its epochs."""

    def __init__(self) -> None:
        self._bar = tqdm(unit="epoch", leave=False, disable=None)
        self._lock, self._tries = Lock(), 0
        self._before = {h: sum(n for g, n in EPOCHS.items() if g < h) for h in EPOCHS}
        self._at: dict[int, int] = {}
        self._best = float("inf")

    def __enter__(self) -> "Bar":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    def tried(self, candidate: Try) -> None:
        """Show a structure that was tried."""
        with self._lock:
            self._tries += 1
            text = f"{self._tries} structures tried, free run {candidate.rmse:.3f}"
            self._bar.set_postfix_str(text)

    def update(self, start: int, horizon: int, epoch: int, best: float) -> None:
        """Show one epoch of one start and its best validation RMSE (scaled)."""
        with self._lock:
            at = self._before.get(horizon, 0) + epoch + 1
            self._bar.update(at - self._at.get(start, 0))
            self._at[start], self._best = at, min(self._best, best)
            self._bar.total = len(self._at) * sum(EPOCHS.values())
            self._bar.set_postfix_str(f"horizon {horizon}, free run {self._best:.3f}")
