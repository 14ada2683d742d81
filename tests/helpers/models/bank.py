"""The sensor bank on one signal."""

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.types import FloatArray
from monitor.judge.response.bank import Bank


def readings(config: ResponseConfig, period_s: float, values: FloatArray) -> FloatArray:
    """Return each hypothesis's reading of each value of a signal, (n, n_hypotheses)."""
    values = np.asarray(values, dtype=np.float64)
    bank, n = Bank(config, period_s), len(values)
    begin = bank.begin(float(values[0]))
    return bank.push(values[np.newaxis], [n], [begin], [(0, 0, n)])[0][0]
