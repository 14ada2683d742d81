"""Impulse responses with confidence bands and dead times; tests of residuals.

Source: Ljung, System Identification, 2nd ed., sections 6.1, 9.3 and 16.6.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import correlate, lfilter
from scipy.stats import chi2, norm

from monitor.base.types import FloatArray
from training.narx.linear.regressors import Stretch, Triangle, triangle

LEVEL = 0.01  # significance level of every test; bands hold 99 %
NOISE_ORDER = 10  # order of the AR noise filter, the reference toolbox's default
TEST_LAGS = 25  # samples, largest of the tests of residuals
VISIBLE = 0.1  # of the peak: smaller responses do not mark the dead time
BAND = float(norm.ppf(1.0 - LEVEL / 2.0))  # half width of a band, in standard errors


def joint_band(count: int) -> float:
    """Return the half width of the band that ``count`` values hold together (Bonferroni)."""
    return float(norm.ppf(1.0 - LEVEL / 2.0 / count))


def cross_covariance(
    a: Sequence[FloatArray], b: Sequence[FloatArray], lags: Sequence[int]
) -> FloatArray:
    """Return the cross covariance (n_lags,): the mean of a(t) b(t - lag), means removed first.

    a, b : series, (n_i,) each; no product reaches across the end of a series
    """
    mean_a, mean_b = np.concatenate(a).mean(), np.concatenate(b).mean()
    total, at = np.zeros(len(lags)), np.array(lags)
    for x, z in zip(a, b, strict=True):
        inside = np.abs(at) < len(x)
        total[inside] += correlate(x - mean_a, z - mean_b)[at[inside] + len(x) - 1]
    return total / sum(map(len, a))


def autocorrelation(series: Sequence[FloatArray], lags: int) -> FloatArray:
    """Return the autocorrelation (lags + 1,) pooled over the series; zeros for a constant."""
    covariance = cross_covariance(series, series, range(lags + 1))
    return covariance / covariance[0] if covariance[0] > 0 else covariance


def effective_samples(a: Sequence[FloatArray], b: Sequence[FloatArray], lags: int) -> float:
    """Return the number of independent pairs that would give the same variance of the correlation.

    Bartlett's formula: n over the sum of the products of both autocorrelations, up to ``lags`` in
    both directions, with a triangular taper.
    """
    product = autocorrelation(a, lags) * autocorrelation(b, lags)
    taper = 1.0 - np.arange(1, lags + 1) / (lags + 1)
    return sum(map(len, a)) / max(1.0 + 2.0 * float(taper @ product[1:]), 1.0)


def whiteness(residuals: Sequence[FloatArray]) -> dict[str, Any]:
    """Return the whiteness test: Ljung-Box, and the lags outside the autocorrelation's 99 % band.

    residuals : series of held-out residuals (the test subtracts no degrees of freedom)
    Ljung-Box joins the series; the ``lags`` products across a joint are accepted as an error.
    """
    n = sum(map(len, residuals))
    lags = min(TEST_LAGS, n - 1)
    joined = autocorrelation([np.concatenate(residuals)], lags)[1:]
    statistic = n * (n + 2) * float(np.sum(joined**2 / (n - np.arange(1, lags + 1))))
    size, p_value = np.abs(autocorrelation(residuals, lags)[1:]), float(chi2.sf(statistic, lags))
    outside = int(np.sum(size > BAND / np.sqrt(n)))
    return {"lags": lags, "outside": outside, "p_value": p_value, "rejected": p_value < LEVEL}


def independence(
    residuals: Sequence[FloatArray], inputs: Sequence[FloatArray], names: Sequence[str]
) -> list[dict[str, Any]]:
    """Return one test per input: do the residuals depend on it?

    inputs : (n, k) per stretch, rows as in ``residuals``
    The test uses the correlation of e(t) with u(t - lag); its standard deviation allows for the
    autocorrelation of both. Independence is rejected if any lag of 0 or above leaves the joint 99 %
    band. A correlation at negative lags means feedback and not a wrong model.
    """
    lags, span = TEST_LAGS, range(-TEST_LAGS, TEST_LAGS + 1)
    sigma_e = float(np.std(np.concatenate(residuals)))
    result = []
    for i, name in enumerate(names):
        signal = [u[:, i] for u in inputs]
        scale = sigma_e * float(np.std(np.concatenate(signal)))
        correlation = cross_covariance(residuals, signal, span) / (scale if scale > 0 else 1.0)
        spread = 1.0 / np.sqrt(effective_samples(residuals, signal, max(4 * lags, 50)))
        limit = joint_band(lags + 1) * spread
        causal, feedback = np.abs(correlation[lags:]), np.abs(correlation[:lags])
        result.append(
            {
                "input": name,
                "lags": span,
                "correlation": correlation,
                "rejected": bool(np.any(causal > limit)),
                "feedback": bool(np.any(feedback > limit)),
            }
        )
    return result


@dataclass(frozen=True, slots=True)
class ImpulseResponse:
    """Responses of the output to pulses of one unit and one sample at the k inputs."""

    response: FloatArray  # (k, lags), output's unit per input's unit
    standard_error: FloatArray  # (k, lags)
    white: FloatArray  # (21,) autocorrelation of the residuals after the noise filter

    def delays(self) -> list[int | None]:
        """Return the dead time of every input in samples, None if no lag leaves the joint band.

        The dead time is the first lag outside the band that all lags of an input hold together in
        99 %, at which the response has at least a tenth of its peak: on long recordings, whose band
        is narrow, leakage between neighbouring samples is significant, too.
        """
        size, band = np.abs(self.response), joint_band(self.response.shape[1]) * self.standard_error
        outside = (size > band) & (size > VISIBLE * size.max(axis=1, keepdims=True))
        return [int(np.argmax(row)) if row.any() else None for row in outside]


def impulse_response(stretches: Sequence[Stretch], lags: int) -> ImpulseResponse:
    """Return the impulse responses of all inputs, fitted jointly by generalised least squares.

    The past outputs of a long ARX model give the disturbance's AR(10) model. It filters inputs and
    output, so that the fit sees nearly white noise. The standard errors allow for the
    autocorrelation that remains, through Bartlett's effective number of samples.
    lags : at most; a stretch must be longer than twice of them
    Raises RecordingError if there are too few samples.
    """
    lags = min(lags, (max(len(y) for _, y in stretches) - NOISE_ORDER - 1) // 2)
    data = triangle(stretches, NOISE_ORDER, lags - 1)
    past = data.solve([*_taps(data, lags), *data.y_at(*range(1, NOISE_ORDER + 1))])[-NOISE_ORDER:]
    noise = [1.0, *-past]
    whitened = [
        (lfilter(noise, [1.0], u, axis=0)[NOISE_ORDER:], lfilter(noise, [1.0], y)[NOISE_ORDER:])
        for u, y in stretches
    ]
    theta, error = _fir(whitened, lags)
    left, driven = [], []
    for u, y in whitened:
        if len(y) > 2 * lags:
            taps = theta[1:].reshape(-1, lags)
            moved = [lfilter(tap, [1.0], u[:, i]) for i, tap in enumerate(taps)]
            left.append((y - theta[0] - np.sum(moved, axis=0))[lags:])
            driven.append(u[lags:])
    k = data.n_inputs
    effective = np.array(
        [effective_samples(left, [u[:, i] for u in driven], 4 * lags) for i in range(k)]
    )
    widened = error[1:].reshape(k, lags) * np.sqrt(sum(map(len, left)) / effective)[:, None]
    return ImpulseResponse(theta[1:].reshape(k, lags), widened, autocorrelation(left, 20))


def _taps(data: Triangle, lags: int) -> list[int]:
    """Return the columns of [1, u1(t) .., u2(t) ..]."""
    return [0, *(c for i in range(data.n_inputs) for c in data.u_at(i, *range(lags)))]


def _fir(stretches: Sequence[Stretch], lags: int) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of [1, u1(t) .., u2(t) ..] and their standard errors."""
    data = triangle(stretches, 0, lags - 1)
    columns = _taps(data, lags)
    theta, left = data.solve(columns), data.factor[:, columns]
    error = data.factor[:, 1] - left @ theta
    variance = float(error @ error) / max(data.rows - len(columns), 1)
    scale = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    inverse = np.linalg.pinv(left / scale, rcond=1e-10)
    return theta, np.sqrt(variance * np.sum(inverse**2, axis=1)) / scale
