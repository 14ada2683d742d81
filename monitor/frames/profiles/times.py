"""The times of a logger's rows: clocks that wrap, repeated rows, pauses, and a log begun anew.

A logger that asks for one signal after the other leaves the other cells of a row blank.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from monitor.frames.blocks import LATEST_S
from monitor.frames.tables.raw_table import DAY_S, HOUR_S, Notes

JITTER_S: Final = 1.0  # a row that much older is out of order; a larger step back begins a new log
ANEW_S: Final = 10.0  # pause that parts a log from the next one in the same file
BEGIN_ANEW: Final = {  # after which clocks and counters begin anew, and how near a step is to it
    **dict.fromkeys((256.0, 65.536, 2**32 / 1e6), JITTER_S),  # s, ms, µs of 8, 16, 32 bits
    **dict.fromkeys((HOUR_S, DAY_S), ANEW_S),  # summer time ends, midnight
}
HELD_S: Final = 0.5  # for which a value is held over blank cells, or three of its own intervals
READING_HELD_S: Final = 5.0  # at most, of the sensor's reading: one that stands for 10 s is stuck
TICKS: Final = (1e17, 1e18)  # of 100 ns, since 1601 or the year 1
TICKS_PER_S: Final = 1e7
DAYS: Final = ((2e4, 6e4), (7.2e5, 7.9e5))  # since 1900, since the year 0
SHORTEST_STEP_S: Final = 1e-4  # of a logger's rows
LONGEST_STEP_S: Final = 60.0
COUNTS: Final = 2.0  # whole steps from here on may be seconds, ms or counts
EPOCH_S: Final = 1e9  # a time since 1970 from 2001 on
LONGEST_IN_NS_S: Final = 1e6  # of times that a float holds to the nanosecond


def cleaned(t_s: FloatArray, wraps_s: float, notes: Notes) -> tuple[IntArray, IntArray]:
    """Return strictly rising times in ns, (k,), and the numbers of the rows they are of, (k,).

    wraps_s : after which the clock starts again, 0 never
    Of rows with the same time the last one counts. Rows without a time (or one that 64 bits of
    nanoseconds do not hold), and rows slightly older than one before them, are left out. If the
    times begin again, the rest follows after a pause.
    """
    t_s = spread(t_s, notes)
    keep = np.abs(t_s) < LATEST_S
    notes.count("rows_without_time", int((~keep).sum()))
    t_s = t_s[keep].copy()
    steps, wraps = np.diff(t_s, prepend=t_s[:1]), np.zeros(len(t_s))
    for whole_s, within_s in BEGIN_ANEW.items():
        wraps[np.abs(steps + whole_s) < within_s] = whole_s
    if wraps_s:
        wraps[steps < -0.5 * wraps_s] = wraps_s
    notes.count("clock_wraps", int(np.count_nonzero(wraps)))
    t_s += np.cumsum(wraps)
    before, after = np.append(-np.inf, t_s)[:-1], np.append(t_s, np.inf)[1:]
    is_odd = (t_s > after + JITTER_S) | (t_s < before - JITTER_S)
    lone = is_odd & (after >= before)  # one row is no log of its own
    keep[keep] = ~lone
    t_s = t_s[~lone]
    steps = np.diff(t_s, prepend=t_s[:1])
    anew = steps < -JITTER_S
    notes.count("logs_begun_anew", int(anew.sum()))
    t_s += np.cumsum(np.where(anew, ANEW_S - steps, 0.0))
    t_ns = in_ns(t_s)
    ordered = np.flatnonzero(t_ns >= np.maximum.accumulate(t_ns))[::-1]
    rising_ns, last = np.unique(t_ns[ordered], return_index=True)
    notes.count("rows_out_of_order", len(t_ns) - len(ordered) + int(lone.sum()))
    notes.count("repeated_times", len(ordered) - len(rising_ns))
    return rising_ns, np.flatnonzero(keep)[ordered[last]]


def in_ns(t_s: FloatArray) -> IntArray:
    """Return times in ns; those since 1970 have microseconds, as a float does and frames do."""
    step_ns = 1 if np.abs(t_s).max(initial=0.0) < LONGEST_IN_NS_S else 1000
    t_ns: IntArray = np.rint(t_s * (1e9 / step_ns)).astype(np.int64) * step_ns
    return t_ns


def spread(t_s: FloatArray, notes: Notes) -> FloatArray:
    """Return times of which many are alike, as those of whole seconds, spread over their step.

    The rows of the first time stand at its end, those of the others from its beginning on.
    """
    same = np.diff(t_s, prepend=np.nan) == 0.0
    if len(t_s) < 2 or np.count_nonzero(same) < len(t_s) // 2:
        return t_s
    first = np.flatnonzero(~same)
    size = np.diff(first, append=len(t_s))
    usual = np.median(size)
    step_s = float(np.median(np.diff(t_s[first]))) if len(first) > 1 else 0.0
    if not step_s > 0.0:
        return t_s
    place = np.arange(len(t_s)) - np.repeat(first, size)
    place[: size[0]] += max(0, int(usual) - int(size[0]))
    notes.count("rows_spread", int(np.count_nonzero(same)))
    spread_s: FloatArray = t_s + step_s * place / np.maximum(np.repeat(size, size), usual)
    return spread_s


def per_second(times: FloatArray, *, are_counts: bool = False) -> float:
    """Return how many units of time, which nobody states, make a second; 0 if nothing tells it.

    are_counts : a text that is no unit stands where one is stated
    Since 1970 they are s, ms, µs or ns; since the year 1 or 1601 ticks of 100 ns; days in a table
    calculation. Of a drive that took more than a day, or a row a minute, they are ms or µs. Whole
    steps of a few may be counts. Most times tell the unit, so that a damaged cell does not.

    >>> per_second(np.array([1.77e12, 1.77e12 + 100.0])), per_second(np.arange(9) * 100.0)
    (1000.0, 1000.0)
    >>> per_second(np.arange(9) * 5.0), per_second(20261128063000.0 + np.arange(9))
    (0.0, 0.0)
    """
    known = times[np.isfinite(times)]
    usual = float(np.median(np.abs(known))) if len(known) else 0.0
    steps = np.diff(known)
    if TICKS[0] < usual < TICKS[1]:
        return TICKS_PER_S
    if usual < EPOCH_S and (known == np.rint(known)).all() and len(steps):
        least = 1.0 if are_counts else COUNTS
        if least <= np.median(steps) <= LONGEST_STEP_S:
            return 0.0
    step = float(np.median(np.abs(steps[steps != 0.0]))) if steps.any() else 0.0
    if step < SHORTEST_STEP_S and any(low < usual < high for low, high in DAYS):
        return 1 / DAY_S
    per_s = 1.0
    while usual > LATEST_S * per_s:
        per_s *= 1000.0
    is_date = per_s > 1.0
    span = float(np.subtract(*np.percentile(known, [95, 5]))) if len(known) else 0.0
    while step > DAY_S * per_s or (
        usual < EPOCH_S * per_s and max(step / LONGEST_STEP_S, span / DAY_S) > per_s
    ):
        per_s *= 1000.0
    is_told = SHORTEST_STEP_S <= step / per_s <= LONGEST_STEP_S or not step
    return per_s if is_told and (not is_date or usual > EPOCH_S * per_s) else 0.0


def in_seconds(times: FloatArray, *, are_counts: bool = False) -> tuple[FloatArray, float]:
    """Return times, whose unit nobody states, in s, and what ``per_second`` says of them."""
    times = of_day(times)
    per_s = per_second(times, are_counts=are_counts)
    first = np.nanmin(times)
    return (times - first * (first > LATEST_S * per_s)) / (per_s or np.nan), per_s


def of_day(times: FloatArray) -> FloatArray:
    """Return seconds; those of times of day that are written as hhmmss leave out 40 a minute.

    >>> of_day(np.array([95957.0, 95958.0, 95959.0, 100000.0])) - 36000.0
    array([-3., -2., -1.,  0.])
    """
    known = np.flatnonzero(np.isfinite(times))
    read = HOUR_S * (times // 1e4) + 60.0 * (times // 100.0 % 100.0) + times % 100.0
    steps, own = (np.diff(each[known]) for each in (times, read))
    own = np.abs((own + DAY_S / 2) % DAY_S - DAY_S / 2)
    if len(own) == 0 or (times[known] % 100.0 >= 60.0).any() or (times[known] % 1e4 >= 6e3).any():
        return times
    return read if np.median(steps) < 40.0 <= np.abs(steps).max() and own.max() < 40.0 else times


def held(cells: FloatArray, t_ns: IntArray, readings: Sequence[int] = ()) -> FloatArray:
    """Return cells, (n, n_columns), with the value before them where they are blank.

    t_ns : (n,) strictly rising
    readings : columns of the sensor's reading
    A value is held for HELD_S, or for three of the usual intervals of its column; a reading for
    READING_HELD_S at most, since the monitor takes one that stands still for a fault.
    """
    if not np.isnan(cells).any():
        return cells
    filled, rows = cells.copy(), np.arange(len(cells))
    for column in range(cells.shape[1]):
        known = ~np.isnan(cells[:, column])
        steps_ns = np.diff(t_ns[known])
        usual_ns = 3.0 * float(np.median(steps_ns)) if len(steps_ns) else 0.0
        last = np.maximum.accumulate(np.where(known, rows, -1))
        age_ns = t_ns - t_ns[last]
        longest_ns = max(1e9 * HELD_S, usual_ns)
        if column in readings:
            longest_ns = min(longest_ns, 1e9 * READING_HELD_S)
        use = ~known & (last >= 0) & (age_ns <= longest_ns)
        filled[use, column] = cells[last[use], column]
    return filled
