"""Windows as they are judged, and the sensor bank on one signal."""

import numpy as np

from monitor.base.config import ResponseConfig
from monitor.base.types import FloatArray
from monitor.judge.bias import Bias
from monitor.judge.findings import WindowJudged
from monitor.judge.response.bank import Bank
from monitor.judge.response.movement import Moved
from monitor.judge.response.rule import Estimates
from monitor.judge.window import Outcome, Window

STILL = np.ones(50)


def judged_window(
    mean: float = 0.0,
    std: float = 0.0,
    outcome: Outcome = "inconclusive",
    fault: str | None = None,
    index: int = 0,
    measured: FloatArray = STILL,
) -> WindowJudged:
    n = len(measured)
    window = Window(
        index=index,
        t_start_ns=0,
        t_end_ns=4_900_000_000,
        measured=measured,
        predicted=np.ones(n),
        bank=np.ones((n, 1)),
    )
    return WindowJudged(
        window=window,
        mean=mean,
        std=std,
        paper_failed=False,
        outcome=outcome,
        fault=fault,
        also=(),
        excited=True,
        response=Estimates(0.0, 0.0, "healthy"),
        bias=Bias("inconclusive", offset=0.0),
        moved=Moved(None, 0.0, 0.0),
    )


def readings(config: ResponseConfig, period_s: float, values: FloatArray) -> FloatArray:
    """Return each hypothesis's reading of each value of a signal, (n, n_hypotheses)."""
    values = np.asarray(values, dtype=np.float64)
    bank, n = Bank(config, period_s), len(values)
    begin = bank.begin(float(values[0]))
    return bank.push(values[np.newaxis], [n], [begin], [(0, 0, n)])[0][0]
