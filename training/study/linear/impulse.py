"""Impulse responses with confidence bands, and the dead times of the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.stats import norm

from monitor.base.types import FloatArray
from training.narx.linear.regressors import Stretch, triangle
from training.study.linear.residual_tests import autocorrelation, effective_samples

LEVEL = 0.01  # bands hold 99 %
NOISE_ORDER = 10  # order of the AR noise filter, the reference toolbox's default
PASSES = 3  # least-squares passes
VISIBLE = 0.1  # of the peak: smaller responses do not mark the dead time


@dataclass(frozen=True, slots=True)
class ImpulseResponse:
    """Responses of the output to pulses of one unit and one sample at the k inputs."""

    response: FloatArray  # (k, lags), output's unit per input's unit
    standard_error: FloatArray  # (k, lags)
    noise: FloatArray  # (11,) AR polynomial of the disturbance
    white: FloatArray  # (21,) autocorrelation of the residuals after the noise filter
    effective_samples: FloatArray  # (k,) independent pairs of filtered residual and input

    @property
    def band(self) -> float:
        """Half width of the 99 % band, in standard errors."""
        return float(norm.ppf(1.0 - LEVEL / 2.0))

    @property
    def joint_band(self) -> float:
        """Half width of the 99 % band for all lags of an input together, in standard errors.

        Bonferroni: by chance a response leaves the band at any lag in 1 % of cases.
        """
        return float(norm.ppf(1.0 - LEVEL / 2.0 / self.response.shape[1]))

    def delays(self) -> list[int | None]:
        """Return the dead time of every input in samples, None if no lag leaves the joint band.

        The dead time is the first lag outside the joint band at which the response has at least a
        tenth of its peak. The second condition is needed on long recordings, where the narrow band
        makes leakage between neighbouring samples significant.
        """
        size = np.abs(self.response)
        outside = size > self.joint_band * self.standard_error
        outside &= size > VISIBLE * size.max(axis=1, keepdims=True)
        return [int(np.argmax(row)) if row.any() else None for row in outside]


def impulse_response(stretches: Sequence[Stretch], lags: int = 50) -> ImpulseResponse:
    """Return the impulse responses of all inputs, fitted jointly by generalised least squares.

    The residuals of a pass give an AR(10) model of the disturbance. It filters inputs and output,
    so that the next of three passes sees nearly white noise. The standard errors allow for the
    autocorrelation that remains, through Bartlett's effective number of samples.
    Raises RecordingError if there are too few samples.
    Source: Ljung, System Identification, 2nd ed., sections 6.1 and 9.3; the order of the noise
    filter is the reference toolbox's default.
    """
    theta = _fir(stretches, lags)[0]
    for _ in range(PASSES - 1):
        noise = _noise_filter(_remainders(stretches, theta, lags))
        whitened = [
            (lfilter(noise, [1.0], u, axis=0)[NOISE_ORDER:], lfilter(noise, [1.0], y)[NOISE_ORDER:])
            for u, y in stretches
        ]
        theta, error = _fir(whitened, lags)
    left = _remainders(whitened, theta, lags)
    driven = [u[lags:] for u, y in whitened if len(y) > 2 * lags]
    n_inputs, count = driven[0].shape[1], sum(map(len, left))
    effective = np.array(
        [effective_samples(left, [u[:, i] for u in driven], 4 * lags) for i in range(n_inputs)]
    )
    widened = error[1:].reshape(n_inputs, lags) * np.sqrt(count / effective)[:, None]
    return ImpulseResponse(
        theta[1:].reshape(n_inputs, lags), widened, noise, autocorrelation(left, 20), effective
    )


def _remainders(stretches: Sequence[Stretch], theta: FloatArray, lags: int) -> list[FloatArray]:
    return [y[lags:] - _output(u, theta)[lags:] for u, y in stretches if len(y) > 2 * lags]


def _fir(stretches: Sequence[Stretch], lags: int) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of [1, u1(t) .., u2(t) ..] and their standard errors."""
    data = triangle(stretches, 0, lags - 1)
    columns = [0, *(c for i in range(data.n_inputs) for c in data.u_at(i, *range(lags)))]
    theta = data.solve(columns)
    left = data.factor[:, columns]
    error = data.factor[:, 1] - left @ theta
    variance = float(error @ error) / max(data.rows - len(columns), 1)
    scale = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    inverse = np.linalg.pinv(left / scale, rcond=1e-10)
    return theta, np.sqrt(variance * np.sum(inverse**2, axis=1)) / scale


def _output(u: FloatArray, theta: FloatArray) -> FloatArray:
    taps = theta[1:].reshape(u.shape[1], -1)
    moved = [lfilter(tap, [1.0], u[:, i]) for i, tap in enumerate(taps)]
    return np.asarray(theta[0] + np.sum(moved, axis=0))


def _noise_filter(residuals: Sequence[FloatArray]) -> FloatArray:
    """Return the polynomial [1, c1 .. c10] of an AR(10) model of the residuals."""
    series = [(np.zeros((len(r), 0)), r) for r in residuals]
    data = triangle(series, NOISE_ORDER, 0)
    return np.concatenate([[1.0], -data.solve([0, *data.y_at(*range(1, NOISE_ORDER + 1))])[1:]])
