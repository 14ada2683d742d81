"""The verdict on a fit, and how sure it is.

A model that was tried on drives it had not seen is judged by the faults that it found there,
another one by how well a free run follows the held-out samples.
"""

from typing import Final

import numpy as np

from monitor.base.signals import BY_NAME
from monitor.judge.trust import Trust, in_words
from monitor.model.card import ModelCard
from training.narx.model_file import FreeRunFit
from training.narx.page.free_run_figures import measured_blocks
from training.pages.numbers import short
from training.recordings import metrics

GOOD: Final = 0.9  # correlation of the free run from which a model follows its vehicle
POOR: Final = 0.6  # below it, a model knows too little of its vehicle to judge it
LEAST_SAMPLES: Final = 50  # a shorter stretch says nothing alone


def fit_verdict(card: ModelCard) -> tuple[str, str]:
    """Return the sentence with its reason, and its kind: good, bad or "" between them."""
    found = card.fit.get("test_enabled") or {}
    which = "enabled held-out"
    if found.get("correlation") is None:
        found, which = card.fit.get("test") or {}, "held-out"
    correlation, rmse = found.get("correlation"), found.get("rmse")
    if correlation is None or rmse is None:
        return "Not known: no held-out sample was predicted. Give more recordings or work.", "bad"
    unit = card.output.unit if card.output.unit not in ("", "-") else ""
    known = card.output.name in BY_NAME  # a signal of vehicles
    subject, records = ("vehicle", "drives") if known else ("system", "recordings")
    trust, bounds = Trust.from_card(card.trust, card.output.name), ""
    if trust.drives:
        does, is_good, is_bad = "can judge", not trust.untested, trust.is_blind("response")
    else:
        does, is_good, is_bad = "follows", correlation >= GOOD, correlation < POOR
        bounds = f" (good from {GOOD:g}, too little below {POOR:g})"
    reason = (
        f"on {found['samples']:,.0f} {which} samples a free run has the correlation "
        f"{correlation:.3f}{bounds} with the measured {card.output.name} "
        f"and an RMSE of {short(rmse)} {unit}".rstrip()
    )
    reason = "; ".join(filter(None, (in_words(trust.entry()), reason)))
    if is_good:
        return f"The model {does} its {subject}: {reason}.", "good"
    if is_bad:
        return f"The model knows too little: {reason}. Give more {records}, or more signals.", "bad"
    return f"The model {does} its {subject} in part: {reason}. More {records} may help.", ""


def fit_confidence(result: FreeRunFit) -> str:
    """Return the sentence: correlations of the held-out stretches, on the verdict's samples."""
    measured, predicted = result.in_units
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
