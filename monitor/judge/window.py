"""Windows of consecutive enabled samples."""

from dataclasses import dataclass

import numpy as np

from monitor.base.types import FloatArray


@dataclass(frozen=True, slots=True)
class Window:
    """A full window; the arrays are copies."""

    index: int
    t_start_ns: int  # of its first sample
    t_end_ns: int  # of its last sample
    measured: FloatArray  # (n,) output's unit
    predicted: FloatArray  # (n,) output's unit
    bank: FloatArray  # (n, n_hypotheses), oriented like phi

    @property
    def residual(self) -> FloatArray:
        """Return measured minus predicted, (n,)."""
        return self.measured - self.predicted


class WindowCollector:
    """Fills windows that do not overlap; whatever interrupts discards the window begun."""

    def __init__(self, n_samples: int, n_hypotheses: int) -> None:
        self._n = n_samples
        self._measured = np.empty(n_samples)
        self._predicted = np.empty(n_samples)
        self._bank = np.empty((n_samples, n_hypotheses))
        self._filled = 0
        self._t_start_ns = 0
        self.completed = 0
        self.discarded = 0

    def push(self, t_ns: int, measured: float, predicted: float, bank: FloatArray) -> Window | None:
        """Take one enabled sample; return the window it completes."""
        i = self._filled
        if i == 0:
            self._t_start_ns = t_ns
        self._measured[i] = measured
        self._predicted[i] = predicted
        self._bank[i] = bank
        self._filled = i + 1
        if self._filled < self._n:
            return None
        self._filled = 0
        self.completed += 1
        return Window(
            self.completed - 1,
            self._t_start_ns,
            t_ns,
            self._measured.copy(),
            self._predicted.copy(),
            self._bank.copy(),
        )

    def interrupt(self) -> None:
        """Discard the window begun."""
        if self._filled:
            self.discarded += 1
        self._filled = 0
