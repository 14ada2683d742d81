"""The grey-box chain's constants from recordings: least squares in free run, several starts.

The chain's misfit changes slowly: it follows the operating point, and the lambda controller answers
it, so that fuel contradicts the reading. Plain least squares then finds a weak sensor without any
lag (span 0.8 instead of 1.0 on simulated drives). So the residual is whitened by its own
autoregression, fitted in turn with the constants (Söderström and Stoica, System Identification,
1989, sections 7.4 and 10.3).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from training.greybox.chain import RANGES, Constants
from training.greybox.fit.case import WHITE, Case, predict
from training.greybox.fit.drive import ChainDrive
from training.greybox.fit.joint import HIGH, LOW, JointFit, JointSearch, fit

BLOCK_S = 45.0  # samples further apart than this count as independent in a standard error
SAMPLES_LEAST = 500
STARTS = (
    Constants(),
    Constants(dead_time_s=0.05, dead_time_revolutions=0.5, mixing_s=0.03, sensor_s=0.05),
    Constants(dead_time_s=0.35, dead_time_revolutions=3.0, mixing_s=0.1, sensor_s=0.3),
    Constants(dead_time_s=0.05, dead_time_revolutions=4.0, mixing_s=0.2, sensor_s=0.5, span=0.8),
)
REFERENCE_RPM = 1500.0  # at which the whole dead time is given
NOISE_ORDER = 2  # of the residual's autoregression, as in ``joint.Case``
ROUNDS = 4  # of constants and autoregression in turn
# Shorter steps end in the worse of two minima. With a tolerance of 1e-5 a fit that starts at the
# bound of ``mixing_s`` stays there.
FROM_AFAR = JointSearch(Constants(), 1e-8, 200)
STANDARD_ERRORS = (
    f"from the Jacobian of the residual whitened by an AR({NOISE_ORDER}), whose remaining "
    f"correlation within blocks of {BLOCK_S:g} s is allowed for (sandwich over blocks)"
)
AT_BOUND = 1e-3  # of the range: a constant so near to its bound ended at it
Report = Callable[[float, float], None]  # share done, 0 to 1; RMSE in phi
PLACE_DIGITS = 3
SWAPPED = (0, 1, 2, 4, 3, 5)  # mixing_s and sensor_s


def nobody(_share: float, _rmse: float) -> None:
    """Tell nobody."""


def part(report: Report, begin: float, end: float) -> Report:
    """Return the report of a part of the work, whose share runs from ``begin`` to ``end``."""
    return lambda done, rmse: report(begin + (end - begin) * done, rmse)


@dataclass(frozen=True, slots=True)
class Fitted:
    """Constants and how well the data determine them."""

    constants: Constants
    covariance: FloatArray  # (n_constants, n_constants), in the order of ``Constants``
    noise_model: tuple[float, ...]  # autoregression of the residual, newest first
    rmse: float  # phi, free run, on the samples of the fit
    white_rmse: float  # phi, after whitening
    samples: int
    spread: float  # of the starts' whitened RMSE, relative: 0 if all of them end in one place
    at_bound: tuple[str, ...]

    @property
    def rows(self) -> dict[str, dict[str, Any]]:
        """Each constant for a card: value, standard error and unit."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).tolist()
        return {
            name: {"value": value, "standard_error": error, "unit": range_.unit}
            for (name, range_), value, error in zip(
                RANGES.items(), self.constants, errors, strict=True
            )
        }


def fit_constants(
    drive: ChainDrive, starts: Sequence[Constants] = STARTS, report: Report = nobody
) -> Fitted:
    """Return the constants with which the chain's free run reads a drive best.

    The chain runs over all samples, so samples soon after a break should not be scored.
    report : is told the share done and the RMSE after every round
    Raises RecordingError if too few samples count.
    """
    at = np.flatnonzero(drive.kept)
    if len(at) < SAMPLES_LEAST:
        raise RecordingError(
            f"{drive.name}: {len(at)} samples enabled and clear of fuel cut, like the "
            f"{NOISE_ORDER} before them, {SAMPLES_LEAST} are wanted to fit the grey-box chain: "
            "give longer recordings with the engine warm and in closed loop, all signals on every "
            "sample of the grid"
        )
    past = at[:, None] - np.arange(1, NOISE_ORDER + 1)
    plain = Case((drive,), (np.zeros(len(drive)),), WHITE)
    tried = [(plain, start) for start in starts]
    for left in reversed(range(ROUNDS)):
        # starts that have come to one place go on together
        ends = dict[tuple[float, ...], tuple[Case, JointFit]]()
        for case, base in tried:
            found = fit(case, (), [base], FROM_AFAR)
            ends.setdefault(_place(found.base), (case, found))
        tried, least = [], np.inf
        for case, found in ends.values():
            e = predict(case, found.base, (), ())[0] - drive.phi_measured
            newest, older = np.linalg.lstsq(e[past], e[at])[0].tolist()
            tried.append((replace(case, ar=(newest, older)), found.base))
            least = min(least, float(np.sqrt(np.mean(e[at] ** 2))))
        report(1.0 - left / ROUNDS, least)
    case, found = min(ends.values(), key=lambda end: end[1].cost)
    costs = [each.cost for _, each in ends.values()]
    off = (predict(case, found.base, (), ())[0] - drive.phi_measured)[drive.scored]
    x, jacobian = np.array(found.base), found.jacobian
    if found.base.mixing_s > found.base.sensor_s:  # the two lags read the same in either order
        x, jacobian = x[list(SWAPPED)], jacobian[:, SWAPPED]
    near = AT_BOUND * (HIGH - LOW)
    stuck = (x - LOW < near) | (HIGH - x < near)
    block = at // max(round(BLOCK_S / drive.period_s), 1)
    return Fitted(
        constants=Constants(*x.tolist()),
        covariance=sandwich(jacobian, found.residual, block),
        noise_model=case.ar,
        rmse=float(np.sqrt(np.mean(off**2))),
        white_rmse=float(np.sqrt(2.0 * found.cost / len(at))),
        samples=int(drive.scored.sum()),
        spread=float(np.sqrt(max(costs) / min(costs)) - 1.0) if min(costs) > 0.0 else 0.0,
        at_bound=tuple(name for name, on in zip(Constants._fields, stuck, strict=True) if on),
    )


def _place(base: Constants) -> tuple[float, ...]:
    """Return the constants to a thousandth of their ranges, the shorter lag first."""
    short, long = sorted((base.mixing_s, base.sensor_s))
    ordered = np.array(base._replace(mixing_s=short, sensor_s=long))
    return tuple(np.round((ordered - LOW) / (HIGH - LOW), PLACE_DIGITS).tolist())


def sandwich(jacobian: FloatArray, residual: FloatArray, block: np.ndarray) -> FloatArray:
    """Return the covariance of a least-squares estimate whose residuals correlate within blocks.

    jacobian : (n, p); residual : (n,); block : (n,) number of each sample's block
    Source: Liang and Zeger, Longitudinal data analysis using generalized linear models, 1986.

    >>> jacobian = np.ones((4, 1))
    >>> residual = np.array([1.0, -1.0, 1.0, -1.0])
    >>> sandwich(jacobian, residual, np.arange(4)).item(), sandwich(jacobian, residual,
    ...          np.array([0, 0, 1, 1])).item()
    (0.25, 0.0)
    """
    bread = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    _, number = np.unique(block, return_inverse=True)
    scores = np.zeros((number.max() + 1, jacobian.shape[1]))
    np.add.at(scores, number, jacobian * residual[:, None])
    return np.asarray(bread @ (scores.T @ scores) @ bread)


def described(fitted: Fitted) -> dict[str, Any]:
    """Return the constants for a card: value, unit, bounds and standard error of each."""
    bounds = {name: {"low": each.low, "high": each.high} for name, each in RANGES.items()}
    return {
        "constants": {name: row | bounds[name] for name, row in fitted.rows.items()},
        "covariance": fitted.covariance.tolist(),
        "standard_errors": STANDARD_ERRORS,
        "fixed": {
            "offset": "0: gain, span and offset give one straight line, which has two numbers",
            "sensor_falling_s": "sensor_s, as sensor_rising_s",
        },
        "at_bound": list(fitted.at_bound),
        "samples": fitted.samples,
        "rmse_phi": fitted.rmse,
        "white_rmse_phi": fitted.white_rmse,
        "noise_model": list(fitted.noise_model),
        "starts_rmse_spread": fitted.spread,
    }


def reference(fitted: Fitted) -> dict[str, Any]:
    """Return the healthy reference: the constants and the sums that recordings determine best.

    A single lag or part of the dead time may be uncertain although their sum is not.
    """
    nothing = Constants(*np.zeros(len(LOW)))
    dead = nothing._replace(dead_time_s=1.0, dead_time_revolutions=60.0 / REFERENCE_RPM)
    lags = nothing._replace(mixing_s=1.0, sensor_s=1.0)
    late = np.add(dead, lags)
    derived = {}
    sums = {"dead_time_at_1500_rpm_s": dead, "lag_s": lags, "late_at_1500_rpm_s": late}
    for name, w in sums.items():
        error = float(np.sqrt(max(np.dot(w, fitted.covariance) @ w, 0.0)))
        value = float(np.dot(w, fitted.constants))
        derived[name] = {"value": value, "standard_error": error, "unit": "s"}
    return {"constants": fitted.rows, "derived": derived, "standard_errors": STANDARD_ERRORS}
