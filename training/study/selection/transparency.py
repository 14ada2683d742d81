"""How much of a sensor fault reaches the prediction through lambda_controller.

The controller computes its output from the measured lambda. A network with this input may predict
the faulty reading, so that the fault hides itself. The controller's law is estimated from the
recordings: its increment as a function of measured and commanded mixture, present and past. Law and
dead time of the loop give the controller's answer to a faulty reading. This answer is added to the
network's input; all other inputs stay unchanged, as if the true mixture did not change.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from scipy import linalg, signal

from monitor.base.faults import resolve
from monitor.base.runs import runs
from monitor.base.types import FloatArray
from monitor.model.step import to_model_units
from training.narx.cross_fit import as_recorded
from training.narx.linear.arx import lagged
from training.narx.search.stages import free_run
from training.recordings.metrics import correlation, correlations
from training.recordings.recording import Recording
from training.recordings.samples.augmentation import CONTROLLER
from training.recordings.samples.preparation import Role, enabled_rows
from training.recordings.sensor_fault import put_on
from training.study.selection.input_sets import Tried

COMMAND = "lambda_target"
TAPS = 5  # past samples of the mixture in the controller's law
MOST_DEAD_TIME = 20  # samples
LIMIT_PERCENTILE = 99.0  # of the distance of readings from their median
SHORTEST = 100  # least samples of a closed-loop stretch
# Faults with their severities, in s or as gain.
FAULTS = (("slow_symmetric", 0.6), ("delay_symmetric", 0.6), ("gain_low", 0.5))


@dataclass(frozen=True, slots=True)
class Controller:
    """Law of the lambda controller, without its commanded part.

    increment(t) = own · increment(t-1) + measured · phi(t..t-5) + commanded · phi(t..t-5)
    """

    own: float
    measured: FloatArray  # (TAPS + 1,)
    dead_time: int  # samples from the command to the reading
    limit: float  # phi; larger deviations of a reading do not occur in closed loop and are clipped
    explained: float  # correlation of increments with the law's, on the last third of the samples

    @property
    def loop(self) -> FloatArray:
        """Denominator of the closed loop; the reading follows the controller with gain 1."""
        law = np.convolve([1.0, -1.0], [1.0, -self.own])
        answer = np.concatenate([np.zeros(self.dead_time), self.measured])
        return polynomial.polysub(law, answer)

    @property
    def stable(self) -> bool:
        """Whether the estimated loop is stable, like a real one."""
        return bool(np.abs(np.roots(self.loop)).max() < 1.0)

    def response(self, change: FloatArray, closed: np.ndarray) -> FloatArray:
        """Return the controller's answer (n,) to a change of the reading.

        change : (n,) in phi
        closed : (n,) bool, samples in closed loop; the answer is 0 elsewhere
        """
        added = np.zeros(len(change))
        for a, b in runs(closed):
            seen = np.clip(change[a:b], -self.limit, self.limit)
            added[a:b] = signal.lfilter(self.measured, self.loop, seen)
        return added


def estimate_controller(recordings: Sequence[Recording], output: str) -> Controller | None:
    """Return the controller's law, fitted by least squares.

    Return None if there is too little closed loop or if the fitted loop is unstable.
    """
    parts = []
    for r in recordings:
        names = [CONTROLLER, output] + ([COMMAND] if COMMAND in r.names else [])
        values = np.column_stack([r.column(n) for n in names])
        values[:, 1:] = to_model_units("phi", values[:, 1:])
        good = np.isfinite(values).all(axis=1) & enabled_rows(r)
        parts += [values[a:b] for a, b in runs(good) if b - a >= SHORTEST]
    if not parts or len({v.shape[1] for v in parts}) > 1:
        return None
    rows = np.concatenate([lagged((v[1:, 1:], np.diff(v[:, 0])), 1, TAPS) for v in parts])
    increment, rows = rows[:, 1], np.delete(rows, 1, axis=1)  # 1, increment(t-1), mixture taps
    cut = 2 * len(rows) // 3
    _, own, *taps = coefficients = linalg.lstsq(rows[:cut], increment[:cut])[0]
    phi, dead_time = np.concatenate([v[:, 1] for v in parts]), TAPS
    if parts[0].shape[1] > 2:  # the lag at which the reading correlates best with the command
        by_lag = correlations([(v[:, 2], v[:, 1]) for v in parts], MOST_DEAD_TIME)
        dead_time = int(np.argmax(by_lag))
    law = Controller(
        own=float(np.clip(own, -0.98, 0.98)),
        measured=np.array(taps[: TAPS + 1]),
        dead_time=dead_time,
        limit=float(np.percentile(np.abs(phi - np.median(phi)), LIMIT_PERCENTILE)),
        explained=correlation(increment[cut:], rows[cut:] @ coefficients),
    )
    return law if law.stable else None


def transparency(
    recordings: Sequence[Recording], tried: Sequence[Tried], output: str
) -> dict[str, Any]:
    """Return the part of every fault that reaches the prediction, for all input sets.

    Scored are the enabled test samples at which the fault changes the reading by at most
    ``Controller.limit``. An entry compares with the reading's change:
    gain : least-squares slope of the prediction's change; 0 ignores the fault, 1 follows it
    share : RMS of the prediction's change
    seen : RMS of the residual's change; 1 if the controller is not an input
    ``controller`` is None, and ``reach`` empty, if no law can be estimated.
    """
    law = estimate_controller(recordings, output)
    if law is None:
        return {"controller": None, "reach": []}
    reach = [
        {"fault": name, "severity": severity, "set": each.set.name}
        | _reach(each, law, name, severity)
        for name, severity in FAULTS
        for each in tried
    ]
    return {"controller": {"explained": law.explained, "dead_time": law.dead_time}, "reach": reach}


def _reach(tried: Tried, law: Controller, fault: str, severity: float) -> dict[str, float]:
    data, scale, model = tried.data, tried.data.scaling, tried.best
    drives = [put_on(r, resolve(fault, severity), data.output.name) for r in data.recordings]
    healthy, faulty = as_recorded(data), as_recorded(replace(data, recordings=tuple(drives)))
    change, u = (faulty.y - healthy.y) * scale.y_std, healthy.u
    parts = [slice(s.start, s.stop) for s in data.segments]
    extra = np.concatenate([law.response(change[rows], data.enabled[rows]) for rows in parts])
    is_moved = np.array([name == CONTROLLER for name in data.names])
    physical = u * scale.u_std + scale.u_mean + extra[:, None]
    moved = np.where(is_moved, scale.scale_u(physical), u)
    runs_of = [
        free_run(replace(data, samples=replace(data.samples, u=each)), model.spec, model.weights)
        for each in (u, moved)
    ]
    answer = (runs_of[1] - runs_of[0]) * scale.y_std
    rows = (data.role == Role.TEST) & data.enabled & np.isfinite(answer)
    rows &= np.abs(change) <= law.limit  # the error of a slow sensor after a fuel cut is larger
    c, a = change[rows], answer[rows]
    size = _rms(c)
    return {"gain": float(a @ c / (c @ c)), "share": _rms(a) / size, "seen": _rms(c - a) / size}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
