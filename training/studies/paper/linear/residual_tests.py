"""Residual analysis: whiteness, and independence of residuals and inputs.

Source: Ljung, System Identification, 2nd ed., section 16.6.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import norm
from statsmodels.stats.diagnostic import acorr_ljungbox

from monitor.base.types import FloatArray

LEVEL = 0.01  # of every test; bands hold 99 %


def cross_covariance(
    a: Sequence[FloatArray], b: Sequence[FloatArray], lags: Sequence[int]
) -> FloatArray:
    """Return the mean of a(t) b(t - lag) over all samples, (n_lags,), after removing the means.

    a, b : series of equal lengths; no product reaches across the end of a series
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
    """Return the autocorrelation (lags + 1,) pooled over the series; 0 for a constant."""
    covariance = cross_covariance(series, series, range(lags + 1))
    return covariance / covariance[0] if covariance[0] > 0 else covariance


def effective_samples(a: Sequence[FloatArray], b: Sequence[FloatArray], lags: int) -> float:
    """Return the number of independent pairs that determine the correlation of ``a`` and ``b``.

    Bartlett's formula: n over the sum of the products of both autocorrelations, over ``lags``
    on both sides with a triangular taper.
    """
    product = autocorrelation(a, lags) * autocorrelation(b, lags)
    taper = 1.0 - np.arange(1, lags + 1) / (lags + 1)
    count = sum(len(x) for x in a)
    inflation = 1.0 + 2.0 * float(taper @ product[1:])
    return count / max(inflation, 1.0)


def whiteness(residuals: Sequence[FloatArray], lags: int = 25) -> dict[str, Any]:
    """Return the whiteness test of residuals: Ljung-Box, and the autocorrelation with its bands.

    residuals : of held-out samples, because no degree of freedom is subtracted
    The series are joined for Ljung-Box; ``lags`` products at each joint are unrelated.
    """
    joined = np.concatenate([r - np.mean(np.concatenate(residuals)) for r in residuals])
    band = float(norm.ppf(1.0 - LEVEL / 2.0) / np.sqrt(len(joined)))
    lags = min(lags, len(joined) - 1)
    rho = autocorrelation(residuals, lags)
    test = acorr_ljungbox(joined, lags=[lags])
    p_value = float(test["lb_pvalue"].iloc[0])
    outside = int(np.sum(np.abs(rho[1:]) > band))
    rejected = bool(p_value < LEVEL)
    return {
        "lags": lags,
        "autocorrelation": rho.tolist(),
        "band": band,
        "outside": outside,
        "statistic": float(test["lb_stat"].iloc[0]),
        "p_value": p_value,
        "rejected": rejected,
    }


def independence(
    residuals: Sequence[FloatArray],
    inputs: Sequence[FloatArray],
    names: Sequence[str],
    lags: int = 25,
) -> list[dict[str, Any]]:
    """Return for each input the test that the residuals are independent of it.

    inputs : shapes (n, k), with the rows of the residuals
    It correlates e(t) with u(t - lag); the standard deviation accounts for the autocorrelation of
    both. The test rejects if a lag of 0 or above leaves the joint 99 % band (Bonferroni). Negative
    lags show feedback, not a defect of the model.
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
