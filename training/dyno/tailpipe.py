"""From a fault of the upstream sensor to emissions: how far it may go until too much passes.

A lambda loop that is led by a faulty sensor leaves the catalyst's window, and what passes then is
counted behind it: carbon monoxide and hydrocarbons with the lack of oxygen of rich gas, nitrogen
oxides with the share that the catalyst no longer converts in lean gas. Both are told as a multiple
of what the same car emits with a sound sensor, which stands for its standard. Everything here is
simulated.

The window: at least 80 % of all three are converted within 0.1 of air/fuel ratio (Heywood, Internal
Combustion Engine Fundamentals, 1988, section 11.6.2); beyond it the conversion of nitrogen oxides
falls on as an exponential.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.faults import resolve
from monitor.base.types import FloatArray
from training.dyno.simulation import Experiment, driven

HALF_WINDOW_X: Final = 0.5 * 0.1 / 14.6
KEPT: Final = 0.8  # converted at the window's edge
DRIVES: Final = tuple(
    Experiment(cycle, 8200 + i, 8_200_000 + i, downstream=True)
    for i, cycle in enumerate(("wltc_3b", "udds", "wltc_3b"))
)
# fault → severities from harmless to severe: s, or the part of the amplitude that is left
SEVERITIES: Final = {
    **{f"{kind}_{edge}": (0.05, 3.0) for kind in ("slow", "delay")
       for edge in ("rich_to_lean", "lean_to_rich", "symmetric")},
    "gain_low": (0.95, 0.05),
}  # fmt: skip
SETTINGS: Final = {  # of [response] → faults whose severity they limit
    "lag_limit_s": ("slow_rich_to_lean", "slow_lean_to_rich"),
    "lag_limit_symmetric_s": ("slow_symmetric",),
    "delay_limit_s": ("delay_rich_to_lean", "delay_lean_to_rich", "delay_symmetric"),
    "gain_weak_max": ("gain_low",),
}
STEPS: Final = 12  # severities of each fault, evenly apart in their logarithm


class Tailpipe(NamedTuple):
    """What leaves the catalyst: carbon monoxide and hydrocarbons, nitrogen oxides; no unit."""

    rich: float
    lean: float


def emitted(experiment: Experiment) -> Tailpipe:
    """Return what a drive emits; the drive needs a catalyst."""
    air, fuel, _ = driven(experiment)
    x, burns = fuel.tailpipe_x, air.fuel_cut < 0.5
    slip = 1.0 - KEPT ** (np.maximum(x, 0.0) / HALF_WINDOW_X)
    flow = air.exhaust_kg_h * burns
    return Tailpipe(float(flow @ np.maximum(-x, 0.0)), float(flow @ slip))


def limits(limit: float, drives: Sequence[Experiment] = DRIVES) -> dict[str, dict[str, Any]]:
    """Return for each fault the severity at which the drives emit ``limit`` times as much, as JSON.

    ``severity``, ``of_each_car`` : where the limit is first crossed, by all drives together and by
        each, a car of its own, alone; None if it is not
    ``pollutant`` : that crosses it, "" if none does
    ``multiples`` : of the emissions with a sound sensor over the ``severities``, of the pollutant
        that rises more
    """
    sound = np.array([emitted(each) for each in drives])
    found = {}
    for name, (harmless, severe) in SEVERITIES.items():
        severities = np.geomspace(harmless, severe, STEPS)
        faults = [resolve(name, severity) for severity in severities.tolist()]
        rows = np.array([[emitted(replace(d, fault=f)) for d in drives] for f in faults])
        ratios = rows.sum(axis=1) / sound.sum(axis=0)
        severity, pollutant = _crossed(severities, ratios, limit)
        each_car = (_crossed(severities, rows[:, i] / sound[i], limit) for i in range(len(drives)))
        found[name] = {
            "severity": severity,
            "unit": "-" if name == "gain_low" else "s",
            "of_each_car": [own for own, _ in each_car],
            "pollutant": pollutant,
            "severities": severities.round(3).tolist(),
            "multiples": ratios.max(axis=1).round(3).tolist(),
        }
    return found


def proposal(limit: float) -> dict[str, Any]:
    """Return the emissions over each fault's severity as JSON holds them, and settings from them.

    limit : multiple of the emissions with a sound sensor, above 1
    Raises UsageError for another one.
    """
    if not limit > 1.0:
        raise UsageError(f"--emission-limit {limit:g}: more than 1 is wanted")
    found = limits(limit)
    response = {}
    for key, names in SETTINGS.items():
        if at := [s for name in names if (s := found[name]["severity"]) is not None]:
            response[key] = round(min(at), 2)
    return {"limit": limit, "source": "simulated", "faults": found, "response": response}


def _crossed(severities: FloatArray, ratios: FloatArray, limit: float) -> tuple[float | None, str]:
    """Return where the larger ratio, (n, 2), crosses the limit, between severities by a line."""
    worst = ratios.max(axis=1)
    beyond = np.flatnonzero(worst > limit)
    if not len(beyond):
        return None, ""
    k = int(beyond[0])
    pollutant = ("CO and HC", "NOx")[int(ratios[k].argmax())]
    if k == 0:
        return round(float(severities[0]), 3), pollutant
    part = (limit - worst[k - 1]) / (worst[k] - worst[k - 1])
    severity = severities[k - 1] * (severities[k] / severities[k - 1]) ** part
    return round(float(severity), 3), pollutant
