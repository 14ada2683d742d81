"""When a logger writes its columns: how often their values change, and how far they are apart.

A logger that polls one quantity after the other repeats old values and shifts columns against each
other. A sensor then seems late, early or weak, though only the log is. What is usual for a vehicle
and its logger stands in the model card.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.types import FloatArray

CHANGES: Final = 20  # clear ones that tell an interval
SELDOM: Final = 0.1  # of the changes that may follow each other faster than the column is written
ALIKE: Final = 0.5  # correlation of the changes of two columns from which their shift is known
MOST_S: Final = 1.0  # shift that is looked for
SLACK: Final = 0.5  # of a sample, by which an interval or a shift may differ


def column_times(values: FloatArray, names: Sequence[str], period_s: float) -> dict[str, Any]:
    """Return the times of columns as a card keeps them.

    values : (n, n_names) samples, NaN where there is none
    ``every_s`` : name → interval of its changes, s; ``apart_s`` : "a b" → by how much b moves
    later than a, least and most, s
    """
    columns = dict(zip(names, values.T, strict=True))
    every = {name: round(interval(column) * period_s, 4) for name, column in columns.items()}
    apart = dict(_apart(columns, period_s))
    return {"every_s": every, "apart_s": {pair: [round(s, 4)] * 2 for pair, s in apart.items()}}


def unlike(
    known: Mapping[str, Any], values: FloatArray, names: Sequence[str], period_s: float
) -> str:
    """Return in words how a table's times differ from those of a card, "" if they do not.

    known : ``column_times`` of the recordings that trained the model
    """
    own = column_times(values, names, period_s)
    slack_s = SLACK * period_s
    for name, usual_s in known["every_s"].items():
        if (every_s := own["every_s"].get(name, 0.0)) > max(usual_s, period_s) + slack_s:
            seen = f"{name} changes every {plain(every_s, 3)} s"
            return f"{seen}, the model needs it every {period_s:g} s"
    far = [
        (max(low - own["apart_s"][pair][0], own["apart_s"][pair][0] - high), pair)
        for pair, (low, high) in known["apart_s"].items()
        if pair in own["apart_s"]
    ]
    beyond_s, pair = max(far, default=(0.0, ""))
    if beyond_s <= slack_s:
        return ""
    apart_s, high = own["apart_s"][pair][0], known["apart_s"][pair][1]
    first, second = next(both for both in combinations(names, 2) if " ".join(both) == pair)
    late, other = (second, first) if apart_s > high else (first, second)
    return (
        f"{late} comes {plain(beyond_s, 2)} s later against {other} than in the recordings "
        "that trained the model"
    )


def interval(column: FloatArray) -> float:
    """Return after how many samples a column (n,) changes at the earliest, 1 if unknown.

    The step of a quantised signal that creeps tells nothing, so only larger changes are looked at.
    """
    at = np.flatnonzero(np.isfinite(column))
    steps = np.abs(np.diff(column[at]))
    changed = np.flatnonzero(steps)
    if len(changed) < CHANGES:
        return 1.0
    is_clear = steps[changed] > 1.5 * steps[changed].min()
    gaps = np.diff(at[changed])[is_clear[1:]]
    return float(np.quantile(gaps, SELDOM)) if len(gaps) >= CHANGES else 1.0


def _apart(columns: Mapping[str, FloatArray], period_s: float) -> Iterator[tuple[str, float]]:
    """Yield for columns that move alike by how much the second of two is later, s.

    The peak of the cross-correlation of their changes, between samples by a parabola (Jacovitti and
    Scarano, Discrete time techniques for time delay estimation, 1993).
    """
    most = max(int(MOST_S / period_s), 1)
    moves = {name: np.nan_to_num(np.diff(column)) for name, column in columns.items()}
    sizes = {name: float(np.linalg.norm(move)) for name, move in moves.items()}
    n = min((len(move) for move in moves.values()), default=0)
    if n < 10 * most:
        return
    for a, b in combinations(columns, 2):
        if not sizes[a] * sizes[b] > 0.0:
            continue
        early = moves[a][most : n - most]
        alike = np.abs(np.correlate(moves[b], early, "valid")) / (sizes[a] * sizes[b])
        peak = int(alike.argmax())
        if alike[peak] >= ALIKE and 0 < peak < 2 * most:
            before, top, behind = alike[peak - 1 : peak + 2].tolist()
            if bend := before - 2.0 * top + behind:  # else the top is flat and tells no shift
                yield f"{a} {b}", (peak - most + 0.5 * (before - behind) / bend) * period_s
