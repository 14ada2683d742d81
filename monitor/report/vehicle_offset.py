"""How far this vehicle's healthy reading lies beside the model's prediction, for drawing only.

A model knows many vehicles; one of them may read a few hundredths of lambda beside it all the time,
from its fuel, its injectors or its sensor. The pages draw the prediction shifted by this distance
beside the plain one. Nothing is judged with it.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from monitor.base.types import FloatArray

if TYPE_CHECKING:
    from monitor.pipeline.collector import Trace

EARLY_S: Final = 180.0  # enabled time that shows the distance, early in the drive
LEAST_S: Final = 30.0  # with less, a single manoeuvre could decide
SMALLEST: Final = 0.003  # of the output; a smaller distance is not seen in the plot
_HIDES: Final = ("biased", "drift", "stuck", "no_activity", "balance")  # what would be learned away


class VehicleOffset:
    """The median distance over the first enabled samples of a drive, before its first code.

    low, high : offsets that a healthy vehicle may have, in the output's unit
    """

    def __init__(self, low: float, high: float, period_s: float) -> None:
        self._low, self._high = low, high
        self._least, self._most = round(LEAST_S / period_s), round(EARLY_S / period_s)
        self._distances: list[float] = []

    def push(self, distances: FloatArray) -> None:
        """Take measured minus predicted of enabled samples that follow each other, (n,)."""
        room = self._most - len(self._distances)
        if room > 0:
            self._distances += distances[np.isfinite(distances)][:room].tolist()

    def value(self, faults: Iterable[str]) -> float | None:
        """Return measured minus predicted of this vehicle, None if it is not to be shown.

        faults : of the codes that are set
        An offset that no healthy vehicle has is never taken for the vehicle's own, nor is one where
        a code tells of an offset or a dead sensor.
        """
        if len(self._distances) < self._least or any(f.startswith(_HIDES) for f in faults):
            return None
        offset = float(np.median(self._distances))
        return offset if self._low <= offset <= self._high and abs(offset) >= SMALLEST else None


def vehicle_offset(recording: Mapping[str, Any], trace: "Trace") -> float | None:
    """Return the offset of a whole recording's vehicle, None if it is not to be shown."""
    low, high = (recording.get("limits", {}).get(name) for name in ("offset_low", "offset_high"))
    period_s = recording.get("period_s")
    if low is None or high is None or not period_s:
        return None
    dtcs = recording["dtcs"]
    until_s = min((dtc["t_s"] for dtc in dtcs if dtc.get("t_s") is not None), default=np.inf)
    own = VehicleOffset(low, high, period_s)
    own.push((trace.measured - trace.predicted)[trace.enabled & (trace.t_s < until_s)])
    return own.value(str(dtc["fault"]) for dtc in dtcs)
