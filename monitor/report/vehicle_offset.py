"""How far this vehicle's healthy reading lies beside the model's prediction, for drawing only.

A model knows many vehicles; one of them may read a few hundredths of lambda beside it all the time,
from its fuel, its injectors or its sensor. The page draws the prediction shifted by this distance
beside the plain one. Nothing is judged with it.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from monitor.report.text import Trace

EARLY_S: Final = 180.0  # enabled time that shows the distance, early in the drive
LEAST_S: Final = 30.0  # with less, a single manoeuvre could decide
SMALLEST: Final = 0.003  # of the output; a smaller distance is not seen in the plot
_HIDES: Final = ("biased", "drift", "stuck", "no_activity", "balance")  # what would be learned away


def vehicle_offset(recording: Mapping[str, Any], trace: "Trace") -> float | None:
    """Return measured minus predicted of this vehicle, in the output's unit; None: not to be shown.

    It is the median over the first enabled samples, before the first code. An offset that no
    healthy vehicle has is never taken for the vehicle's own, nor is one where a code tells of an
    offset or a dead sensor.
    """
    dtcs = recording["dtcs"]
    if any(str(dtc["fault"]).startswith(_HIDES) for dtc in dtcs):
        return None
    low, high = (recording.get("limits", {}).get(name) for name in ("offset_low", "offset_high"))
    period_s = recording.get("period_s")
    if low is None or high is None or not period_s:
        return None
    until_s = min((dtc["t_s"] for dtc in dtcs if dtc.get("t_s") is not None), default=np.inf)
    distance = trace.measured - trace.predicted
    usable = np.flatnonzero(trace.enabled & np.isfinite(distance) & (trace.t_s < until_s))
    usable = usable[: round(EARLY_S / period_s)]
    if len(usable) < LEAST_S / period_s:
        return None
    offset = float(np.median(distance[usable]))
    return offset if low <= offset <= high and abs(offset) >= SMALLEST else None
