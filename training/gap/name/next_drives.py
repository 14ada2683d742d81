"""How much more driving tells candidates apart, and with which probability.

The verdict draws blocks, so further blocks are taken as these are: their mean is as uncertain as
their spread and number say. A chain cannot promise that, because no candidate is true to its form.
Source: Geisser, Predictive Inference, 1993 (distribution of a future sample's mean).
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final

from scipy.special import ndtr, ndtri

from monitor.base.types import FloatArray
from training.gap.name.ranking import WIN
from training.gap.name.verdict import Candidate, NextDrives
from training.greybox.fit.case import Case

TIMES: Final = (1, 3, 7)  # the present driving
LIKELY: Final = 0.8


def next_drives(case: Case, candidates: Sequence[Candidate]) -> NextDrives | None:
    """Return the driving after which the first candidate is likely named alone; None of one.

    If even the most is not enough, it is told with its probability.
    """
    if len(candidates) < 2:
        return None
    first, *rivals = candidates
    for times in TIMES:
        odds = min(named_after(times, rival.left - first.left) for rival in rivals)
        if odds >= LIKELY:
            break
    present_s = sum(map(len, case.rows)) * case.drives[0].period_s
    return NextDrives(times * present_s, first.label, odds)


def named_after(times: int, excess: FloatArray) -> float:
    """Return the probability that resampled blocks will prefer a candidate in WIN of draws.

    times : as many further blocks, over those that there are
    excess : (n_blocks,) deviance that its rival leaves more than it
    """
    whole = 1 + times
    t = float(excess.mean()) / max(float(excess.std()), 1e-12) * sqrt(len(excess))
    wanted = ndtri(WIN) * sqrt(whole)
    return float(ndtr((whole * t - wanted) / sqrt(times * whole)))
