"""Lagged regressors of several unbroken stretches, condensed into one triangular factor.

A stretch is ``(u, y)`` with shapes (n, k) and (n,) on one sample grid. No regressor reaches across
the end of a stretch. R is the triangular factor of the rows
``[1, y(t) .. y(t-Ly), u1(t) .. u1(t-Lu), u2(t) ..]``. Least squares on any columns of R gives the
same result as on all samples, but R has only as many rows as columns.
"""

from collections.abc import Iterator, Sequence
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

    def y_at(self, *lags: int) -> list[int]:
        """Return the column numbers of y(t - lag)."""
        return [1 + lag for lag in lags]

    def u_at(self, index: int, *lags: int) -> list[int]:
        """Return the column numbers of input ``index`` at t - lag."""
        return [2 + self.y_lags + index * (self.u_lags + 1) + lag for lag in lags]

    def solve(self, columns: Sequence[int]) -> FloatArray:
        """Return the least-squares coefficients (n_columns,) of y(t) on these columns."""
        left = self.factor[:, columns]
        scale = np.linalg.norm(left, axis=0)
        scale[scale == 0.0] = 1.0
        return np.asarray(np.linalg.lstsq(left / scale, self.factor[:, 1], rcond=1e-10)[0] / scale)


def lagged_rows(stretch: Stretch, y_lags: int, u_lags: int) -> Iterator[FloatArray]:
    """Yield chunks (rows, 2 + y_lags + k (u_lags + 1)) of the regressors with full history."""
    u, y = stretch
    longest = max(y_lags, u_lags)
    if len(y) <= longest:
        return

    def windows(signal: FloatArray, lags: int) -> FloatArray:
        return sliding_window_view(signal[longest - lags :], lags + 1)[:, ::-1]

    parts = [windows(y, y_lags), *(windows(u[:, i], u_lags) for i in range(u.shape[1]))]
    for start in range(0, len(y) - longest, CHUNK):
        piece = [part[start : start + CHUNK] for part in parts]
        yield np.concatenate([np.ones((len(piece[0]), 1)), *piece], axis=1)


def triangle(stretches: Sequence[Stretch], y_lags: int, u_lags: int) -> Triangle:
    """Return the condensed stretches; a stretch shorter than its lags is left out.

    Raises RecordingError if there are too few samples.
    Source: sequential QR, Golub and Van Loan, Matrix Computations, section 5.3.
    """
    n_inputs = stretches[0][0].shape[1]
    width = 2 + y_lags + n_inputs * (u_lags + 1)
    factor, rows = np.zeros((0, width)), 0
    for stretch in stretches:
        for chunk in lagged_rows(stretch, y_lags, u_lags):
            factor = np.asarray(np.linalg.qr(np.vstack([factor, chunk]), mode="r"))
            rows += len(chunk)
    if rows <= width // 2:
        raise RecordingError(f"{rows} samples with full history for {width} lagged signals")
    return Triangle(factor, rows, n_inputs, y_lags, u_lags)
