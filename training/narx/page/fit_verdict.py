"""The verdict on a fit in one sentence: how well a free run follows the held-out samples."""

from typing import Final

from monitor.base.signals import BY_NAME
from monitor.model.card import ModelCard
from training.pages.numbers import short

GOOD: Final = 0.9  # correlation of the free run from which a model follows its vehicle
POOR: Final = 0.6  # below it, a model knows too little of its vehicle to judge it


def fit_verdict(card: ModelCard) -> tuple[str, str]:
    """Return the sentence with its reason, and its kind: good, bad or "" between them."""
    found = card.fit.get("test_enabled") or {}
    which = "enabled held-out"
    if found.get("correlation") is None:
        found, which = card.fit.get("test") or {}, "held-out"
    correlation, rmse = found.get("correlation"), found.get("rmse")
    if correlation is None or rmse is None:
        return "Not known: no held-out samples could be predicted. Give more recordings.", "bad"
    unit = card.output.unit if card.output.unit not in ("", "-") else ""
    reason = (
        f"on {found['samples']:,.0f} {which} samples a free run has the correlation "
        f"{correlation:.3f} with the measured {card.output.name} (good from {GOOD:g}, too little "
        f"below {POOR:g}) and an RMSE of {short(rmse)} {unit}".rstrip()
    )
    known = card.output.name in BY_NAME  # a signal of vehicles
    subject, records = ("vehicle", "drives") if known else ("system", "recordings")
    if correlation >= GOOD:
        return f"The model follows its {subject}: {reason}.", "good"
    if correlation < POOR:
        return f"The model knows too little: {reason}. Give more {records}, or more signals.", "bad"
    return f"The model follows its {subject} in part: {reason}. More {records} may help.", ""
