"""Measures of a simulation against the measurement."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.base.types import FloatArray


def _checked(measured: FloatArray, simulated: FloatArray) -> tuple[FloatArray, FloatArray]:
    if measured.shape != simulated.shape:
        raise ValueError(f"shapes differ: {measured.shape} and {simulated.shape}")
    if not len(measured):
        raise ValueError("there are no samples")
    return measured, simulated


def rmse(measured: FloatArray, simulated: FloatArray) -> float:
    """Return the root mean squared residual, in the unit of the arguments.

    >>> rmse(np.array([1.0, 1.0]), np.array([0.0, 2.0]))
    1.0
    """
    measured, simulated = _checked(measured, simulated)
    return float(np.sqrt(np.mean((measured - simulated) ** 2)))


def fit_percent(measured: FloatArray, simulated: FloatArray) -> float:
    """Return the normalised RMSE fit in percent, 100 for a perfect simulation.

    measured, simulated : shape (n,), the same unit
    Raises ValueError if the shapes differ or ``measured`` is constant.
    Source: Ljung, System Identification, 2nd ed., section 16.4.

    >>> fit_percent(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    100.0
    """
    measured, simulated = _checked(measured, simulated)
    spread = float(np.linalg.norm(_about_mean(measured)))
    if spread == 0.0:
        raise ValueError("the measurement is constant")
    return 100.0 * (1.0 - float(np.linalg.norm(measured - simulated)) / spread)


def correlation(measured: FloatArray, simulated: FloatArray) -> float:
    """Return Pearson's correlation coefficient; 0 if either is constant.

    >>> round(correlation(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 4.0])), 12)
    1.0
    """
    measured, simulated = _checked(measured, simulated)
    a, b = _about_mean(measured), _about_mean(simulated)
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.clip(a @ b / scale, -1.0, 1.0)) if scale > 0 else 0.0


def correlations(pairs: Sequence[tuple[FloatArray, FloatArray]], most: int) -> list[float]:
    """Return the correlation of the second signals with the earlier first ones, by lag."""
    result = []
    for lag in range(most + 1):
        late = [(a[: len(a) - lag], b[lag:]) for a, b in pairs if len(a) > lag]
        u, y = (np.concatenate(each) for each in zip(*late, strict=True))
        result.append(correlation(u, y))
    return result


def slope(measured: FloatArray, simulated: FloatArray) -> float:
    """Return the slope of the least-squares line of simulated over measured.

    Raises ValueError if ``measured`` is constant.

    >>> slope(np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0]))
    2.0
    """
    measured, simulated = _checked(measured, simulated)
    a = _about_mean(measured)
    if not a.any():
        raise ValueError("the measurement is constant")
    return float(a @ (simulated - simulated.mean()) / (a @ a))


def measures(measured: FloatArray, simulated: FloatArray) -> dict[str, Any]:
    """Return samples, errors and likeness by name; likeness is None for a constant measurement."""
    residual, most = measured - simulated, float(np.abs(measured).max(initial=1.0))
    varies = len(measured) > 1 and float(np.ptp(measured)) > 1e-9 * most
    return {
        "samples": len(measured),
        "rmse": rmse(measured, simulated),
        "fit_percent": fit_percent(measured, simulated) if varies else None,
        "correlation": correlation(measured, simulated) if varies else None,
        "slope": slope(measured, simulated) if varies else None,
        "residual_mean": float(residual.mean()),
        "residual_std": float(residual.std()),
    }


def _about_mean(values: FloatArray) -> FloatArray:
    """Return values less their mean: 0 if they are all the same, whose mean may be rounded."""
    return values - (values.mean() if np.ptp(values) else values[0])
