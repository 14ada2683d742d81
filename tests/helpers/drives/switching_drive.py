"""Drives with switching sensors before and behind a catalyst, made apart from the dynamometer."""

import numpy as np

from monitor.base.types import FloatArray


def switching_drive(
    *, stores: bool, period_s: float = 0.2, seconds: float = 90.0, late_s: float = 0.3
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times in s, front and rear voltages, (n,) each.

    The front sensor switches about every 0.8 s. Behind a catalyst that stores, the rear sensor only
    follows excursions of 4 s, which come twice a minute.
    """
    fine_s = np.arange(0.0, seconds, 0.02)
    rng = np.random.default_rng(3)
    edges = np.cumsum(rng.uniform(0.6, 1.1, len(fine_s)))
    rich = np.searchsorted(edges, fine_s) % 2 == 0
    rich |= fine_s % 30.0 < 4.0
    rich &= ~((fine_s + 15.0) % 30.0 < 4.0)
    if stores:
        long = (fine_s % 30.0 < 4.0) | ((fine_s + 15.0) % 30.0 < 4.0)
        last = np.maximum.accumulate(np.where(long, np.arange(len(fine_s)), 0))
        behind = rich[last]
    else:
        behind = rich
    shift = round(late_s / 0.02)
    behind = np.concatenate([np.full(shift, behind[0]), behind[:-shift]])
    at = np.arange(0, len(fine_s), round(period_s / 0.02))
    front_v, rear_v = (np.where(x, 0.8, 0.1) + 0.02 * np.sin(fine_s) for x in (rich, behind))
    return fine_s[at], front_v[at], rear_v[at]
