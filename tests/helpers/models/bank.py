"""The sensor bank on one signal."""

import numpy as np

from monitor.base.types import FloatArray
from monitor.judge.response.bank import Bank, Hypothesis, Spans


def readings(hypotheses: tuple[Hypothesis, ...], period_s: float, values: FloatArray) -> FloatArray:
    """Return each hypothesis's reading of each value of a signal, (n, n_hypotheses)."""
    values = np.asarray(values, dtype=np.float64)
    bank, n = Bank(hypotheses, period_s), len(values)
    begin = bank.begin(float(values[0]))
    return bank.push(values[np.newaxis], [n], [begin], Spans([0], [0], [n]))[0]
