"""How much of a sensor fault reaches the prediction through lambda_controller.

The controller makes its output from the measured lambda. A network that sees it may predict the
faulty reading: the fault then hides itself. A drive with the fault in the loop cannot tell how
much, since its mixture changes, too. So the controller's law is estimated from the recordings: its
increment from the mixture measured and commanded, present and past. What it adds for a faulty
reading, while the loop answers with the dead time found, is put on the network's input; every
other input stays as if the true mixture were unchanged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, signal

from monitor.base.faults import SensorFault, resolve
from monitor.base.types import FloatArray
from monitor.model.step import from_model_units, to_model_units
from training.narx.network import simulate
from training.narx.stages import measured_history
from training.recordings.metrics import correlation
from training.recordings.preparation import CONTROLLER, Role, enabled_rows, runs
from training.recordings.recording import Recording
from training.studies.paper.selection.input_sets import Tried, exact_inputs

COMMAND = "lambda_target"
TAPS = 5  # past samples of the mixture that the controller's law may use
MOST_DEAD_TIME = 20  # samples
LIMIT_PERCENTILE = 99.0  # of the readings' distance from their median, see Controller.limit
SHORTEST = 100  # samples of a closed-loop stretch that is used
FAULTS = (("slow_symmetric", 0.6), ("delay_symmetric", 0.6), ("gain_low", 0.5))


@dataclass(frozen=True, slots=True)
class Controller:
    """increment(t) = own · increment(t-1) + measured · phi(t..t-5) + commanded · phi(t..t-5)."""

    own: float
    measured: FloatArray  # (TAPS + 1,)
    dead_time: int  # samples from the command to the reading
    limit: float  # phi; what readings in closed loop leave their middle by, larger is not answered
    explained: float  # correlation of the increments with what the law says, on the last third

    @property
    def loop(self) -> FloatArray:
        """Denominator of the loop in which the reading follows the controller, gain 1."""
        law = np.convolve([1.0, -1.0], [1.0, -self.own])
        answer = np.concatenate([np.zeros(self.dead_time), self.measured])
        size = max(len(law), len(answer))
        return np.pad(law, (0, size - len(law))) - np.pad(answer, (0, size - len(answer)))

    @property
    def stable(self) -> bool:
        """Whether the estimated loop forgets, as a real one does."""
        return bool(np.abs(np.roots(self.loop)).max() < 1.0)

    def response(self, change: FloatArray, closed: np.ndarray) -> FloatArray:
        """Return what the controller adds (n,) for a ``change`` of the reading in phi (n,)."""
        added = np.zeros(len(change))
        for a, b in runs(closed):
            seen = np.clip(change[a:b], -self.limit, self.limit)
            added[a:b] = signal.lfilter(self.measured, self.loop, seen)
        return added


def estimate_controller(recordings: Sequence[Recording], output: str) -> Controller | None:
    """Return the controller's law by least squares.

    None if there is too little closed loop, or the law found does not close a stable loop.
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
    rows = np.concatenate([_regression(v) for v in parts])
    cut = 2 * len(rows) // 3
    coefficients = linalg.lstsq(rows[:cut, 1:], rows[:cut, 0])[0]
    phi = np.concatenate([v[:, 1] for v in parts])
    law = Controller(
        float(np.clip(coefficients[0], -0.98, 0.98)),
        coefficients[1 : TAPS + 2],
        _dead_time(parts),
        float(np.percentile(np.abs(phi - np.median(phi)), LIMIT_PERCENTILE)),
        correlation(rows[cut:, 0], rows[cut:, 1:] @ coefficients),
    )
    return law if law.stable else None


def _dead_time(parts: Sequence[FloatArray]) -> int:
    """Return the lag of the reading behind the command at which they correlate best."""
    if parts[0].shape[1] < 3:
        return TAPS
    found = [
        correlation(
            np.concatenate([v[: len(v) - lag, 2] for v in parts]),
            np.concatenate([v[lag:, 1] for v in parts]),
        )
        for lag in range(MOST_DEAD_TIME + 1)
    ]
    return int(np.argmax(found))


def _regression(values: FloatArray) -> FloatArray:
    """Return rows of increment, the one before, taps of the mixture, and a constant."""
    increment = np.diff(values[:, 0])
    n = len(increment)
    taps = [values[TAPS + 1 - j : len(values) - j, 1:] for j in range(TAPS + 1)]
    by_signal = np.stack(taps, axis=1).transpose(0, 2, 1).reshape(n - TAPS, -1)
    return np.column_stack(
        [increment[TAPS:], increment[TAPS - 1 : -1], by_signal, np.ones(n - TAPS)]
    )


def transparency(
    recordings: Sequence[Recording], tried: Sequence[Tried], output: str
) -> dict[str, Any]:
    """Return what reaches the prediction of each set, per fault.

    Scored are enabled test samples at which the fault is within what closed loop knows.

    gain : least-squares slope of the prediction's change over the reading's change; 0 is a
        prediction that knows nothing of the fault, 1 one that follows it
    share : RMS of the prediction's change over that of the reading's
    seen : RMS of the residual's change over that of the reading's, 1 without the input
    """
    law = estimate_controller(recordings, output)
    if law is None:
        return {"controller": None, "reach": []}
    reach = []
    for name, severity in FAULTS:
        for each in tried:
            found = _reach(each, law, name, severity)
            reach.append({"fault": name, "severity": severity, "set": each.set.name, **found})
    found = {"explained": law.explained, "dead_time": law.dead_time}
    return {"controller": found, "reach": reach}


def _reach(tried: Tried, law: Controller, fault: str, severity: float) -> Mapping[str, float]:
    data, spec = tried.data, tried.spec
    names = [c.name for c in data.inputs]
    phi = data.scaling.unscale_y(data.samples.y)
    change, extra = np.zeros(len(phi)), np.zeros(len(phi))
    for s in data.segments:
        rows = slice(s.start, s.stop)
        sensor = SensorFault(resolve(fault, severity), data.period_ns / 1e9)
        read = np.array(sensor.apply(from_model_units("phi", phi[rows])))
        change[rows] = to_model_units("phi", read) - phi[rows]
        extra[rows] = law.response(change[rows], data.enabled[rows])
    u = exact_inputs(data)
    moved = u
    if CONTROLLER in names:
        i = names.index(CONTROLLER)
        scale = data.scaling
        moved = u.copy()
        at = u[:, i] * scale.u_std[i] + scale.u_mean[i] + extra
        at = np.clip(at, scale.u_low[i], scale.u_high[i])
        moved[:, i] = (at - scale.u_mean[i]) / scale.u_std[i]
    start = np.array([s.start + spec.lags for s in data.segments], dtype=np.int64)
    stop = np.array([s.stop for s in data.segments], dtype=np.int64)
    history = measured_history(data, spec.lags, start)
    weights = tried.starts[tried.best].weights
    runs_of = [simulate(spec, weights, each, start, stop, history) for each in (u, moved)]
    answer = (runs_of[1] - runs_of[0]) * data.scaling.y_std
    rows = (data.role == Role.TEST) & data.enabled & np.isfinite(answer)
    rows &= np.abs(change) <= law.limit  # after a fuel cut a slow sensor is off by more
    c, a = change[rows], answer[rows]
    size = float(np.sqrt(np.mean(c**2)))
    return {
        "gain": float(a @ c / (c @ c)),
        "share": float(np.sqrt(np.mean(a**2))) / size,
        "seen": float(np.sqrt(np.mean((c - a) ** 2))) / size,
    }
