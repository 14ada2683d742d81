"""Fuel cuts: delay, rise and level of their steps, read off measurement and prediction.

Entering a cut makes the exhaust lean at once, and after the return it is burnt gas again. Both
steps reach the sensor after the gas has travelled, so a step of the measurement is compared with
the step of the prediction, which knows the exhaust's flow. In a long cut the sensor stands in air:
its level there shows the sensor's span.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import FuelCutConfig
from monitor.base.runs import alike, runs, since
from monitor.base.types import BoolArray, FloatArray, IntArray

LEVEL: Final = "level"  # of a long cut, oriented like phi
# by the edge with which a cut begins, and that with which it ends
QUANTITIES: Final = (
    "delay_rich_to_lean_s",
    "rise_rich_to_lean_s",
    "delay_lean_to_rich_s",
    "rise_lean_to_rich_s",
    LEVEL,
)
_DELAY, _RISE = (
    0.2,
    0.8,
)  # of a step: its delay lasts to the first, its rise from there to the other
_MOVING: Final = 0.15  # of a step that still goes on within its end, so that nobody knows its size
_SETTLED_S: Final = 0.5  # the end of a step, which shows where it leads


class CutReading(NamedTuple):
    """One quantity of one fuel cut."""

    measured: float
    predicted: float


@dataclass(frozen=True, slots=True)
class Cut:
    """What one fuel cut shows."""

    t_ns: int  # of the first sample with fuel cut
    seen: dict[str, CutReading]  # some of QUANTITIES
    is_flat: bool = False  # the reading of its level does not move at all
    pressure_kpa: float = math.nan  # of the ambient air, NaN if not known


class Stretch(NamedTuple):
    """Samples in a row of one recording: one before a fuel cut, the cut, and what follows it."""

    t_ns: IntArray  # (n,)
    measured: FloatArray  # (n,) oriented like phi
    predicted: FloatArray  # (n,) oriented like phi
    is_cut: BoolArray  # (n,)

    def part(self, begin: int, end: int) -> "Stretch":
        """Return the samples from begin to end."""
        inside = slice(begin, end)
        return Stretch(
            self.t_ns[inside], self.measured[inside], self.predicted[inside], self.is_cut[inside]
        )


def cuts_of(stretch: Stretch, config: FuelCutConfig, period_s: float, least: float) -> list[Cut]:
    """Return what the fuel cuts of a stretch show.

    least : a step of prediction or measurement that is smaller shows nothing
    """
    spans = runs(stretch.is_cut)
    begins = [*(begin for begin, _ in spans), len(stretch.t_ns)]
    found = []
    for (begin, end), following in zip(spans, begins[1:], strict=True):
        if begin == 0 or (end - begin) * period_s < config.least_s:
            continue
        stop = min(following, end + round(config.return_s / period_s))
        seen = _edge("rich_to_lean", stretch.part(begin - 1, end), -least, period_s)
        is_flat = False
        seen |= _edge("lean_to_rich", stretch.part(end - 1, stop), least, period_s)
        if (end - begin) * period_s >= config.level_after_s:
            last = stretch.part(end - round(config.level_s / period_s), end)
            seen[LEVEL] = CutReading(
                float(np.median(last.measured)), float(np.median(last.predicted))
            )
            is_flat = bool(np.ptp(last.measured) == 0.0)
        found.append(Cut(stretch.t_ns.item(begin), seen, is_flat))
    return found


def _edge(name: str, part: Stretch, least: float, period_s: float) -> dict[str, CutReading]:
    """Return delay and rise of a step, nothing if measurement or prediction shows none.

    least : smallest step, with its sign
    """
    measured, predicted = (_step(each, least, period_s) for each in (part.measured, part.predicted))
    if measured is None or predicted is None:
        return {}
    pairs = map(CutReading, measured, predicted)
    return {f"{what}_{name}_s": each for what, each in zip(("delay", "rise"), pairs, strict=True)}


def _step(values: FloatArray, least: float, period_s: float) -> tuple[float, float] | None:
    """Return delay and rise in s of a step that begins after the first value, None without one."""
    settled = max(round(_SETTLED_S / period_s), 1)
    if len(values) <= 2 * settled:
        return None
    end = values[-settled:]
    size = float(np.median(end)) - values.item(0)
    if size / least < 1.0 or (end[-1] - end[0]) / size > _MOVING:
        return None
    share = (values - values[0]) / size
    delay, both = _reached(share, _DELAY), _reached(share, _RISE)
    return delay * period_s, (both - delay) * period_s


def _reached(share: FloatArray, part: float) -> float:
    """Return after how many samples a step first reaches a part of itself.

    >>> _reached(np.array([0.0, 0.0, 0.4, 1.0]), 0.2)
    1.5
    """
    k = int(np.argmax(share >= part))
    before, now = share[k - 1 : k + 1].tolist()
    return float(k - 1 + (part - before) / (now - before))


class FuelCuts:
    """Finds the fuel cuts of a recording, block by block.

    least : smallest step that shows something
    most_s : a longer cut shows nothing, so that a flag that is always set needs no memory
    """

    def __init__(self, config: FuelCutConfig, period_s: float, least: float, most_s: float) -> None:
        self._config, self._period_s, self._least = config, period_s, least
        self._most = round(most_s / period_s)
        self._return = round(config.return_s / period_s)
        self._since = np.array([self._return + 1])  # samples since the last with fuel cut
        self._before: list[Stretch] = []  # the sample before, if it is usable
        self._open: list[Stretch] = []

    @property
    def is_idle(self) -> bool:
        """Return whether no cut was near the latest sample."""
        return not self._open and bool(self._since[0] > self._return)

    def push(self, samples: Stretch, usable: BoolArray) -> list[tuple[int, Cut]]:
        """Take samples; return the cuts that are over, each with the number of the sample after.

        usable : (n,) nothing but a fuel cut disables the sample, and there is a prediction
        """
        count = since(samples.is_cut[:, np.newaxis], self._since)
        self._since = count[-1]
        found: list[tuple[int, Cut]] = []
        near = count[:, 0] <= self._return
        for begin, end, code in alike(np.where(usable, near + 1, 0)):
            part = samples.part(begin, end)
            if code == 2:
                self._open += [*self._before, part]
                self._before = []
                if sum(len(each.t_ns) for each in self._open) > self._most:
                    self._open = []
                continue
            found += [(begin, cut) for cut in self._ended()]
            self._before = [samples.part(end - 1, end)] if code else []
        return found

    def _ended(self) -> list[Cut]:
        """Return the cuts of the stretch that is over."""
        if not self._open:
            return []
        whole = Stretch(*map(np.concatenate, zip(*self._open, strict=True)))
        self._open = []
        return cuts_of(whole, self._config, self._period_s, self._least)
