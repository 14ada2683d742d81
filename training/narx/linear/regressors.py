"""Lagged regressors of several unbroken stretches, condensed into one triangular factor.

A stretch is ``(u, y)`` with shapes (n, k) and (n,) on one sample grid. No regressor reaches across
the end of a stretch. R is the triangular factor of the rows
``[1, y(t) .. y(t-Ly), u1(t) .. u1(t-Lu), u2(t) ..]``. Least squares on any columns of R gives the
same result as on all samples, but R has only as many rows as columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray

Stretch = tuple[FloatArray, FloatArray]
CHUNK = 4000  # rows condensed at a time


def largest_order(stretches: Sequence[Stretch], wanted: int) -> int:
    """Return the largest model order for the data, at most ``wanted``.

    The data need ten samples per parameter, and half of the stretches eight times the order.
    Raises RecordingError if the order would be below 2.
    """
    lengths = np.array([len(y) for _, y in stretches])
    signals = stretches[0][0].shape[1] + 1
    order = int(min(wanted, lengths.sum() // (10 * signals), np.median(lengths) // 8))
    if order < 2:
        raise RecordingError(
            f"{lengths.sum()} samples in {len(lengths)} stretches are too few for linear models "
            f"with {signals - 1} inputs, at least {max(20 * signals, 16)} in one are wanted"
        )
    return order


@dataclass(frozen=True, slots=True)
class Triangle:
    """The factor R (m, m) of all lagged regressors; its Gram matrix is R.T @ R."""

    factor: FloatArray
    rows: int  # number of condensed samples
    n_inputs: int
    y_lags: int
    u_lags: int

    def columns(self, na: int, nb: int, delays: Sequence[int]) -> list[int]:
        """Return the numbers of those of an ARX model, see ``columns_of``."""
        return columns_of(self.y_lags, self.u_lags, na, nb, delays)

    def solve(self, columns: Sequence[int]) -> FloatArray:
        """Return the least-squares coefficients (n_columns,) of y(t) on these columns."""
        left = self.factor[:, columns]
        scale = np.linalg.norm(left, axis=0)
        scale[scale == 0.0] = 1.0
        return np.asarray(np.linalg.lstsq(left / scale, self.factor[:, 1], rcond=1e-10)[0] / scale)

    def left(self, columns: Sequence[int]) -> FloatArray:
        """Return what these columns leave of y(t), a vector (m,) of the same norm."""
        return self.factor[:, 1] - self.factor[:, columns] @ self.solve(columns)

    def standard_errors(self, columns: Sequence[int]) -> FloatArray:
        """Return those of the coefficients (n_columns,), if what is left is white."""
        variance = float(np.sum(self.left(columns) ** 2)) / max(self.rows - len(columns), 1)
        inverse = np.linalg.pinv(self.factor[:, columns], rcond=1e-10)
        return np.sqrt(variance * np.sum(inverse**2, axis=1))


def columns_of(y_lags: int, u_lags: int, na: int, nb: int, delays: Sequence[int]) -> list[int]:
    """Return the numbers of the columns 1, u1(t - delay) .., u2(t - delay) .., y(t-1) .."""
    first = [2 + y_lags + i * (u_lags + 1) + delay for i, delay in enumerate(delays)]
    return [0, *(at + tap for at in first for tap in range(nb)), *range(2, 2 + na)]


def lagged(stretch: Stretch, y_lags: int, u_lags: int) -> FloatArray:
    """Return the rows (n - longest lag, 2 + y_lags + k (u_lags + 1)) with full history."""
    u, y = stretch
    longest = max(y_lags, u_lags)

    def windows(signal: FloatArray, lags: int) -> FloatArray:
        return sliding_window_view(signal[longest - lags :], lags + 1)[:, ::-1]

    one = np.ones((len(y) - longest, 1))
    return np.concatenate([one, windows(y, y_lags), *(windows(x, u_lags) for x in u.T)], axis=1)


def triangle(stretches: Sequence[Stretch], y_lags: int, u_lags: int) -> Triangle:
    """Return the condensed stretches; a stretch shorter than its lags is left out.

    Raises RecordingError if there are too few samples.
    Source: sequential QR, Golub and Van Loan, Matrix Computations, section 5.3.
    """
    n_inputs = stretches[0][0].shape[1]
    width = 2 + y_lags + n_inputs * (u_lags + 1)
    factor, rows = np.zeros((0, width)), 0
    for stretch in (s for s in stretches if len(s[1]) > max(y_lags, u_lags)):
        every = lagged(stretch, y_lags, u_lags)
        for start in range(0, len(every), CHUNK):
            chunk = every[start : start + CHUNK]
            factor = np.asarray(np.linalg.qr(np.vstack([factor, chunk]), mode="r"))
        rows += len(every)
    if rows <= width // 2:
        raise RecordingError(f"{rows} samples with full history for {width} lagged signals")
    return Triangle(factor, rows, n_inputs, y_lags, u_lags)
