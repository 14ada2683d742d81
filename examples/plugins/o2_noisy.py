"""Judges the residual's noise: a loose plug makes it large in windows of any driving."""

from types import MappingProxyType

import numpy as np

from monitor.judge.window import Opinion

NOISE_MOST = 0.02  # lambda, median of the steps from sample to sample
WINDOWS = 3  # before the rule has an opinion


class Noisy:
    """A rule; the monitor makes a new one for every driving cycle."""

    faults = MappingProxyType({"noisy": "P1130"})  # fault: code, one of the manufacturer's

    def __init__(self):
        self._noise = []

    def judge(self, window):
        """Take 50 enabled samples; return what all windows so far say."""
        self._noise.append(np.median(np.abs(np.diff(window.residual))))
        if len(self._noise) < WINDOWS:
            return Opinion("inconclusive")
        is_noisy = np.median(self._noise) > NOISE_MOST
        return Opinion("failed", "noisy") if is_noisy else Opinion("passed")
