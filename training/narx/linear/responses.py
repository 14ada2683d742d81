"""Impulse responses with confidence bands and dead times; tests of residuals.

Several stretches stand end to end in a series; the few products of a correlation that reach across
a joint are accepted as an error.
Source: Ljung, System Identification, 2nd ed., sections 6.1, 9.3 and 16.6.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import correlate, lfilter
from scipy.stats import chi2, norm

from monitor.base.types import FloatArray
from training.narx.linear.arx import solve_arx, triangle
from training.narx.linear.models import LinearModel, Stretch

LEVEL = 0.01  # significance level of every test; bands hold 99 %
NOISE_ORDER = 10  # order of the AR noise filter, the reference toolbox's default
TEST_LAGS = 25  # samples, largest of the tests of residuals
VISIBLE = 0.1  # of the peak: smaller responses do not mark the dead time


def band(count: int = 1) -> float:
    """Return the half width, in standard errors, of the band that ``count`` values hold together.

    Source: Bonferroni.
    """
    return float(norm.ppf(1.0 - LEVEL / 2.0 / count))


def correlation(a: FloatArray, b: FloatArray, lags: Sequence[int]) -> FloatArray:
    """Return the correlation (n_lags,) of a(t) with b(t - lag); zeros for a constant."""
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return np.asarray(correlate(a, b)[np.array(lags) + len(a) - 1] / (scale or 1.0))


def effective_samples(a: FloatArray, b: FloatArray, lags: int) -> float:
    """Return the number of independent pairs that would give the same variance of the correlation.

    Bartlett's formula: n over the sum of the products of both autocorrelations, up to ``lags`` in
    both directions, with a triangular taper.
    """
    own = range(1, min(lags, len(a) - 1) + 1)
    taper = 1.0 - np.array(own) / (lags + 1)
    products = correlation(a, a, own) * correlation(b, b, own)
    return len(a) / max(1.0 + 2.0 * float(taper @ products), 1.0)


def whiteness(residuals: FloatArray) -> dict[str, Any]:
    """Return the whiteness test: Ljung-Box, and the lags outside the autocorrelation's 99 % band.

    residuals : (n,), held out, so that the test subtracts no degrees of freedom
    """
    n = len(residuals)
    lags = range(1, min(TEST_LAGS, n - 1) + 1)
    own = correlation(residuals, residuals, lags)
    p_value = float(chi2.sf(n * (n + 2) * np.sum(own**2 / (n - np.array(lags))), len(lags)))
    outside = int(np.sum(np.abs(own) > band() / np.sqrt(n)))
    return {"lags": len(lags), "outside": outside, "p_value": p_value, "rejected": p_value < LEVEL}


def independence(
    residuals: FloatArray, inputs: FloatArray, names: Sequence[str]
) -> list[dict[str, Any]]:
    """Return one test per input (n, k): do the residuals (n,) depend on it?

    The test uses the correlation of e(t) with u(t - lag); its standard deviation allows for the
    autocorrelation of both. Independence is rejected if any lag of 0 or above leaves the joint 99 %
    band. A correlation at negative lags means feedback and not a wrong model.
    """
    lags, result = range(-TEST_LAGS, TEST_LAGS + 1), []
    for name, signal in zip(names, inputs.T, strict=True):
        found = correlation(residuals, signal, lags)
        spread = 1.0 / np.sqrt(effective_samples(residuals, signal, 4 * TEST_LAGS))
        beyond = np.abs(found) > band(TEST_LAGS + 1) * spread
        result.append(
            {
                "input": name,
                "largest": np.abs(found[TEST_LAGS:]).max(),
                "rejected": bool(beyond[TEST_LAGS:].any()),
                "feedback": bool(beyond[:TEST_LAGS].any()),
            }
        )
    return result


@dataclass(frozen=True, slots=True)
class ImpulseResponse:
    """Responses of the output to pulses of one unit and one sample at the k inputs."""

    response: FloatArray  # (k, lags), output's unit per input's unit
    standard_error: FloatArray  # (k, lags)

    def delays(self) -> list[int | None]:
        """Return the dead time of every input in samples, None if no lag leaves the joint band.

        The dead time is the first lag outside the band that all lags of an input hold together in
        99 %, at which the response has at least a tenth of its peak: on long recordings, whose band
        is narrow, leakage between neighbouring samples is significant, too.
        """
        size, joint = np.abs(self.response), band(self.response.shape[1]) * self.standard_error
        outside = (size > joint) & (size > VISIBLE * size.max(axis=1, keepdims=True))
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
    none = (0,) * stretches[0][0].shape[1]
    noise = solve_arx(triangle(stretches, NOISE_ORDER, lags - 1), NOISE_ORDER, lags, none).poly

    def whitened(signal: FloatArray) -> FloatArray:
        return np.asarray(lfilter(noise, [1.0], signal, axis=0))[NOISE_ORDER:]

    white = [(whitened(u), whitened(y)) for u, y in stretches]
    data = triangle(white, 0, lags - 1)
    columns = [0, *range(2, data.factor.shape[1])]
    theta, error = data.solve(columns), data.standard_errors(columns)[1:].reshape(-1, lags)
    model = LinearModel(np.zeros(0), theta[1:].reshape(-1, lags), none, float(theta[0]))
    long = [(u, y) for u, y in white if len(y) > 2 * lags]
    left = np.concatenate([model.errors(u, y)[lags:] for u, y in long])
    driven = np.concatenate([u[lags:] for u, _ in long])
    effective = np.array([effective_samples(left, u, 4 * lags) for u in driven.T])
    widened = error * np.sqrt(len(left) / effective)[:, None]
    return ImpulseResponse(model.b, widened)
