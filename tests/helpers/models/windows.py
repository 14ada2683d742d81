"""Windows as they are judged."""

import numpy as np

from monitor.base.types import FloatArray
from monitor.judge.bias import Bias
from monitor.judge.findings import WindowEstimates, WindowJudged
from monitor.judge.response.movement import Moved
from monitor.judge.response.rule import Estimates
from monitor.judge.window import Outcome, Window

UNDECIDED = Bias("inconclusive", offset=0.0)
NOTHING_SEEN = WindowEstimates(Estimates(0.0, 0.0, "healthy"), UNDECIDED, Moved(None, 0.0, 0.0))
STILL = np.ones(50)


def judged_window(
    mean: float = 0.0,
    std: float = 0.0,
    outcome: Outcome = "inconclusive",
    fault: str | None = None,
    index: int = 0,
    measured: FloatArray = STILL,
) -> WindowJudged:
    """Return a verdict on a window of five seconds."""
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
        statistics=NOTHING_SEEN,
    )
