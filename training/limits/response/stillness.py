"""For how long a healthy reading may stand still.

The longest stillness that a few healthy drives show is no limit: the drive after a single one
exceeds it with a probability of a half. So the limit is a prediction bound from the tail of all
their stretches, which grows as fewer stretches support it. It is short for a reading that resolves
its own noise; where a reading stands still for minutes now and then, it is hours, so the tests of a
still reading are silent.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, FloatArray
from monitor.judge import enable
from monitor.judge.electrical.suite import STRETCHES_OF_A_CODE, ActivityTest, ElectricalTests
from monitor.model.card import Limit, ModelCard
from training.limits.judging import checked
from training.recordings.recording import Recording

FALSE_SHARE = 0.001  # of the healthy drives that may exceed the bound
TAIL = 10  # longest stretches of a drive, on average, that tell the tail
RESOLVED_S = 1.0  # much shorter stretches are chance: the noise is hardly larger than a step
DAY_S = 86_400.0  # longer than any drive


def still_limits(
    recordings: Sequence[Recording], card: ModelCard, config: Config
) -> dict[str, Limit]:
    """Return how long the reading of healthy recordings may stand still, if unusually long."""
    time_s = next_longest([_still_stretches(each, card, config) for each in recordings])
    where = f"exceeded in {FALSE_SHARE:g} of the drives, by {len(recordings)} healthy recordings"
    is_long = time_s > STRETCHES_OF_A_CODE * config.plausibility.stuck_s
    return {"still_s": Limit(time_s, "s", where)} if is_long else {}


def next_longest(drives: Sequence[Sequence[float]]) -> float:
    """Return what the longest stretch of a further drive exceeds with probability FALSE_SHARE.

    drives : the stretches of each, in s
    The longest stretches follow a Lomax distribution, whose exponent they tell (Hill, A simple
    general approach to inference about the tail of a distribution, Annals of Statistics 3 (1975)).
    The logarithms are exponential, so the bound for a further one is exact for any number.

    >>> round(next_longest([[0.1] * 90 + [0.2] * 9 + [0.3]]), 1)
    3.6
    >>> round(next_longest([[0.2, 1.0, 2.0, 3.0, 5.0, 8.0, 13.0, 20.0, 30.0, 40.0]]))
    86400
    """
    longest = np.sort([0.0, *(s for drive in drives for s in drive)])[::-1] + RESOLVED_S
    n = min(TAIL * len(drives), len(longest) - 1)
    if not n:
        return 0.0
    share = FALSE_SHARE * len(drives) / n  # of the further drive's stretches
    beyond = np.log(longest[:n] / longest[n]).sum() * (share ** (-1.0 / n) - 1.0)
    factor = math.exp(min(beyond, math.log(2.0 * DAY_S)))
    return min(longest[n].item() * factor - RESOLVED_S, DAY_S)


def _still_stretches(recording: Recording, card: ModelCard, config: Config) -> list[float]:
    """Return the times in s for which the reading stands still though a live sensor must move.

    At the end of its range it need not where nothing says whether the fuel is cut.
    """
    period_s, most = card.period_ns * 1e-9, config.plausibility.stuck_range
    names, block, _, held = checked(recording, card, config)
    tests = ElectricalTests(config, names, card.output, period_s)
    burning = enable.holds(enable.masks(held), enable.BURNING)
    *_, active = tests.push(block.values, block.quality, burning)
    test = ActivityTest(config.plausibility, card.output, names, period_s)
    return [
        length * period_s
        for length, level in _stretches(recording.column(card.output.name), active, most)
        if not (test.is_cold(level) or test.is_at_end(level))
    ]


def _stretches(measured: FloatArray, active: BoolArray, most: float) -> Iterator[tuple[int, float]]:
    """Yield samples and last reading of the stretches in which the reading stands still.

    active : (n,) whether a sample counts
    most : by how much the reading may move
    """
    low, high, last, count = math.inf, -math.inf, math.nan, 0
    for value, counts in zip(measured.tolist(), active.tolist(), strict=True):
        is_still = not math.isnan(value) and max(high, value) - min(low, value) <= most
        if count and not is_still:
            yield count, last
            count = 0
        if not count:
            low, high = math.inf, -math.inf
        if counts or count:
            low, high, count = min(low, value), max(high, value), count + counts
            last = value if counts else last
    if count:
        yield count, last
