"""Residual tests: whiteness, and independence of the inputs.

Source: Ljung, System Identification, 2nd ed., section 16.6.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from monitor.base.types import FloatArray

LEVEL = 0.01  # significance level of every test; bands hold 99 %


def cross_covariance(
    a: Sequence[FloatArray], b: Sequence[FloatArray], lags: Sequence[int]
) -> FloatArray:
    """Return the cross covariance (n_lags,): the mean of a(t) b(t - lag), means removed first.

    a, b : series, (n_i,) each; no product reaches across the end of a series
    """
    mean_a, mean_b = np.concatenate(a).mean(), np.concatenate(b).mean()
    total, count = np.zeros(len(lags)), sum(len(x) for x in a)
    for x, z in zip(a, b, strict=True):
        x, z = x - mean_a, z - mean_b  # noqa: PLW2901
        for i, lag in enumerate(lags):
            if abs(lag) < len(x):
                late, early = (x[lag:], z[: len(z) - lag]) if lag >= 0 else (x[:lag], z[-lag:])
                total[i] += late @ early
    return total / count


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
    count = sum(len(x) for x in a)
    inflation = 1.0 + 2.0 * float(taper @ product[1:])
    return count / max(inflation, 1.0)


def whiteness(residuals: Sequence[FloatArray], lags: int = 25) -> dict[str, Any]:
    """Return the whiteness test: Ljung-Box, and the autocorrelation with its 99 % band.

    residuals : series of held-out residuals (the test subtracts no degrees of freedom)
    Ljung-Box joins the series; the ``lags`` products across a joint are accepted as an error.
    """
    joined = np.concatenate([r - np.mean(np.concatenate(residuals)) for r in residuals])
    band = float(norm.ppf(1.0 - LEVEL / 2.0) / np.sqrt(len(joined)))
    lags = min(lags, len(joined) - 1)
    rho = autocorrelation(residuals, lags)
    n, own = len(joined), autocorrelation([joined], lags)[1:]
    statistic = float(n * (n + 2) * np.sum(own**2 / (n - np.arange(1, lags + 1))))
    p_value = float(chi2.sf(statistic, lags))
    outside = int(np.sum(np.abs(rho[1:]) > band))
    rejected = bool(p_value < LEVEL)
    return {
        "lags": lags,
        "autocorrelation": rho.tolist(),
        "band": band,
        "outside": outside,
        "statistic": statistic,
        "p_value": p_value,
        "rejected": rejected,
    }


def independence(
    residuals: Sequence[FloatArray],
    inputs: Sequence[FloatArray],
    names: Sequence[str],
    lags: int = 25,
) -> list[dict[str, Any]]:
    """Return one test per input: do the residuals depend on it?

    inputs : (n, k) per stretch, rows as in ``residuals``
    The test uses the correlation of e(t) with u(t - lag); its standard deviation allows for the
    autocorrelation of both. Independence is rejected if any lag of 0 or above leaves the joint 99 %
    band (Bonferroni). A correlation at negative lags means feedback and not a wrong model.
    """
    span = range(-lags, lags + 1)
    memory = max(4 * lags, 50)
    sigma_e = float(np.std(np.concatenate(residuals)))
    result = []
    for i, name in enumerate(names):
        signal = [u[:, i] for u in inputs]
        scale = sigma_e * float(np.std(np.concatenate(signal)))
        correlation = cross_covariance(residuals, signal, span) / (scale if scale > 0 else 1.0)
        spread = 1.0 / np.sqrt(effective_samples(residuals, signal, memory))
        limit = float(norm.ppf(1.0 - LEVEL / 2.0 / (lags + 1)) * spread)
        causal, feedback = np.abs(correlation[lags:]), np.abs(correlation[:lags])
        result.append(
            {
                "input": name,
                "lags": list(span),
                "correlation": correlation.tolist(),
                "band": float(norm.ppf(1.0 - LEVEL / 2.0) * spread),
                "joint_band": limit,
                "rejected": bool(np.any(causal > limit)),
                "worst_lag": int(np.argmax(causal)),
                "feedback": bool(np.any(feedback > limit)),
            }
        )
    return result
