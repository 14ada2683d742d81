"""Verdicts on the models of the NARX study: overfits, underfits, diverges and others.

Errors are RMSE on enabled samples in scaled units, averaged over the starts. The spread of a model
is the standard deviation over its starts.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from training.recordings.samples.preparation import Prepared

UNDER = 1.25  # times the lowest error, training or one-step validation
OVER = 1.1  # times the ratio of test to training error of the model with the fewest weights
DECEIVES = 1.5  # times the lowest free-run error, at a one-step error within UNDER
SAMPLES_PER_WEIGHT = 10  # with fewer samples per weight every network overfits
SPREADS = 2.0  # least excess of an overfit, in spreads of the test error

ROLES = {"train": "training", "validate": "validation", "test": "test"}

Model = Mapping[str, Any]


def errors(model: Model, mode: str, role: str) -> FloatArray:
    """Return the RMSE of every start, inf for a start without one.

    mode : ``one_step`` or ``free_run``
    role : ``train``, ``validate`` or ``test``
    """
    values = [s[mode][role]["enabled"]["mse"] for s in model["starts"]]
    return np.array([np.inf if v is None else np.sqrt(v) for v in values])


def correlations(model: Model, mode: str, role: str) -> FloatArray:
    """Return the correlation of every start, NaN for a start without one."""
    values = [s[mode][role]["enabled"]["r"] for s in model["starts"]]
    return np.array([np.nan if v is None else v for v in values])


def judge(models: Sequence[Model]) -> list[list[str]]:
    """Return the labels of every model."""
    train, test = (
        np.array([errors(m, "one_step", role).mean() for m in models]) for role in ("train", "test")
    )
    smallest = int(np.argmin([m["n_weights"] for m in models]))
    harder = test[smallest] / train[smallest]
    one_step, free = (
        np.array([errors(m, mode, "validate").min() for m in models])
        for mode in ("one_step", "free_run")
    )
    one_step, free, ratio = one_step / one_step.min(), free / free.min(), test / train
    result = []
    for i, m in enumerate(models):
        tests = errors(m, "one_step", "test")
        spread = SPREADS * tests.std(ddof=1) if len(tests) > 1 and np.isfinite(tests).all() else 0.0
        diverges = any(s["diverged"] for s in m["starts"])
        found = {
            "underfits": errors(m, "one_step", "train").min() > UNDER * train.min(),
            "overfits": ratio[i] > OVER * harder and test[i] - harder * train[i] > spread,
            "diverges": diverges,
            "one-step deceives": not diverges and one_step[i] <= UNDER and free[i] > DECEIVES,
            "unfinished": any(s["unfinished"] for s in m["starts"]),
        }
        result.append([label for label, holds in found.items() if holds])
    return result


def warnings(given: Prepared, data: Prepared, models: Sequence[Model]) -> list[str]:
    """Return warnings about the table of models as sentences.

    given : all samples
    data : the samples that the study used
    """
    n = data.n_train
    large = sum(n < SAMPLES_PER_WEIGHT * m["n_weights"] for m in models)
    diverged = sum(s["diverged"] for m in models if m["same_as"] is None for s in m["starts"])
    result = []
    if large:
        result.append(
            f"{large} of {len(models)} models have more than one weight per "
            f"{SAMPLES_PER_WEIGHT} of the {n} training samples: expect them to overfit"
        )
    if data.enabled.mean() > given.enabled.mean() + 0.01:
        result.append("hardly a sample is enabled: figures are over all samples instead")
    if diverged:
        result.append(f"trainings that diverge in free run: {diverged}; the table says which")
    return result
