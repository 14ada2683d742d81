"""How sure the verdict on a fit is: how alike the held-out stretches are, each alone."""

from typing import Final

import numpy as np

from training.narx.model_file import FreeRunFit
from training.narx.page.free_run_figures import measured_blocks, output_units
from training.recordings import metrics

LEAST_SAMPLES: Final = 50  # a shorter stretch says nothing alone


def fit_confidence(result: FreeRunFit) -> str:
    """Return the sentence: correlations of the held-out stretches, on the verdict's samples."""
    measured, predicted = output_units(result)
    known = np.isfinite(measured) & np.isfinite(predicted)
    enabled = known & result.data.enabled
    found = []
    for _, first, stop in measured_blocks(result.data):
        rows = first + np.flatnonzero((enabled if enabled.any() else known)[first:stop])
        if len(rows) >= LEAST_SAMPLES and np.ptp(measured[rows]) > 0.0:
            found.append(metrics.correlation(measured[rows], predicted[rows]))
    if not found:
        return "not known: no held-out stretch is long enough to judge it alone."
    if len(found) == 1:
        return "low: it rests on one held-out stretch."
    low, middle, high = np.quantile(found, [0.0, 0.5, 1.0])
    return (
        f"the correlation is {middle:.3f} in the median of {len(found)} held-out stretches "
        f"alone, between {low:.3f} and {high:.3f}."
    )
