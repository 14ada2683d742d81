"""The error of two models over the variable on which the old model's error depends most."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.response.drivers import find_drivers
from training.greybox.fit.drive import Comparison

PARTS: Final = 16  # of the samples, alike in number
PARTS_LEAST: Final = 4
ANSWERS: Final = ("lambda_controller", "phi_predicted")  # to the mixture, no causes


@dataclass(frozen=True, slots=True)
class ErrorCurve:
    """Mean of measured minus predicted in parts of a variable's range."""

    driver: str
    at: FloatArray  # (n_parts,) mean of the variable, in its unit
    before: FloatArray  # (n_parts,) in phi
    after: FloatArray | None  # None without a new model


def error_curve(
    before: Sequence[Comparison], after: Sequence[Comparison] | None
) -> ErrorCurve | None:
    """Return the curve over the signal, or what is made of signals, that explains most."""
    both = [runs for runs in (before, after) if runs is not None]
    errors = [np.concatenate([r.residual[r.scored] for r in runs]) for runs in both]
    best, most = None, 0.0
    for driver in find_drivers(before):
        x = np.concatenate([v[r.scored] for v, r in zip(driver.values, before, strict=True)])
        edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, PARTS + 1)))
        if len(edges) <= PARTS_LEAST or driver.name in ANSWERS:
            continue
        part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
        count = np.bincount(part)
        at, found, *then = (np.bincount(part, v) / np.maximum(count, 1) for v in (x, *errors))
        explained = float(count @ (found - errors[0].mean()) ** 2)
        if explained > most:
            after_it = then[0] if then else None
            most, best = explained, ErrorCurve(driver.name, at, found, after_it)
    return best
