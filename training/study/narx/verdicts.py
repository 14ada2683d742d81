"""Verdicts on the models of the NARX study (overfits, underfits, diverges ...), by stated rules.

Errors are RMSE on enabled samples in scaled units, averaged over the starts. The spread of a model
is the standard deviation over its starts.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from monitor.base.types import FloatArray
from training.recordings.samples.preparation import Prepared, Role
from training.study.narx.candidates import ALGORITHMS

UNDER = 1.25  # times the lowest error, training or one-step validation
OVER = 1.1  # times the ratio of test to training error of the model with the fewest weights
DECEIVES = 1.5  # times the lowest free-run error, at a one-step error within UNDER
SAMPLES_PER_WEIGHT = 10  # with fewer samples per weight every network overfits
SPREADS = 2.0  # least excess of an overfit, in spreads of the test error
HARD = 1.5  # largest ratio of test to training error expected of the smallest model

ROLES = {"train": "training", "validate": "validation", "test": "test"}

Model = Mapping[str, Any]


def rules(iterations: int) -> list[str]:
    """Return the rules as sentences."""
    return [
        f"Underfits: the one-step training error of even the best start is more than {UNDER:g} "
        "times the lowest mean of all models.",
        f"Overfits: the one-step test error over the training error is more than {OVER:g} times "
        "that of the model with the fewest weights (which says how much harder the test blocks "
        f"are), and the excess is more than {SPREADS:g} spreads of the test error.",
        f"One-step deceives: the one-step validation error is within {UNDER:g} times the lowest, "
        f"the free-run one more than {DECEIVES:g} times the lowest.",
        "Diverges: in free run a start predicts held-out samples worse than their mean does, or "
        "more than 1 % of its predictions lie at an end of the output's range while the "
        "measurement does not.",
        f"Unfinished: the error still fell by 1 % over the last tenth of the {iterations} "
        "iterations allowed, in at least one start.",
    ]


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


def judge(models: Sequence[Model], iterations: int) -> list[dict[str, Any]]:
    """Return a dict per model: ``labels``, and ``words`` with the numbers behind the labels.

    iterations : largest number of epochs of a training
    """
    train, test = (_means(models, role) for role in ("train", "test"))
    smallest = int(np.argmin([m["n_weights"] for m in models]))
    harder = test[smallest] / train[smallest]
    one_step, free = (_least(models, mode) for mode in ("one_step", "free_run"))
    one_step, free, ratio = one_step / one_step.min(), free / free.min(), test / train
    result = []
    for i, m in enumerate(models):
        least = errors(m, "one_step", "train").min() / train.min()
        spread = SPREADS * _std(errors(m, "one_step", "test"))
        diverged = sum(s["diverged"] for s in m["starts"])
        deceives = not diverged and one_step[i] <= UNDER and free[i] > DECEIVES
        overfits = ratio[i] > OVER * harder and test[i] - harder * train[i] > spread
        words = {
            "underfits": least > UNDER and f"training error {least:.2g} times the lowest or more",
            "overfits": overfits
            and f"test error {ratio[i]:.2f} times the training error, {harder:.2f} times for the "
            "smallest model",
            "diverges": diverged and f"{diverged} of {len(m['starts'])} starts diverge in free run",
            "one-step deceives": deceives
            and f"one-step error {one_step[i]:.2f} times the lowest, free-run error {free[i]:.2f} "
            "times",
            "unfinished": any(s["unfinished"] for s in m["starts"])
            and f"the error still fell after {iterations} iterations",
        }
        said = {label: text for label, text in words.items() if text}
        result.append({"labels": list(said), "words": "; ".join(map(str, said.values()))})
    return result


def _means(models: Sequence[Model], role: str) -> FloatArray:
    return np.array([errors(m, "one_step", role).mean() for m in models])


def _least(models: Sequence[Model], mode: str) -> FloatArray:
    return np.array([errors(m, mode, "validate").min() for m in models])


def _std(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 and np.isfinite(values).all() else 0.0


def findings(result: Mapping[str, Any]) -> list[str]:
    """Return the findings of the study as sentences, from the result of ``compared``."""
    once = [m for m in result["models"] if m["same_as"] is None]
    return [
        *_fitting(once),
        *_algorithms(once),
        *_effective_weights(once),
        *_one_step_against_free(once),
        *_tuning(result["tuned"]),
    ]


def warnings(given: Prepared, data: Prepared, models: Sequence[Model]) -> list[str]:
    """Return warnings about the table of models as sentences.

    given : all samples
    data : the samples that the study used
    """
    n = int(((data.role == Role.TRAIN) & (data.samples.weight > 0)).sum())
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
        result.append(f"{diverged} trainings diverge in free run; the table says which")
    return result


def _fitting(models: Sequence[Model]) -> list[str]:
    sentences = []
    for label in ("underfit", "overfit", "diverge"):
        numbers = [str(m["number"]) for m in models if f"{label}s" in m["verdict"]["labels"]]
        sentences.append(
            f"{len(numbers)} of {len(models)} different trainings {label} by the rules below "
            f"(models {', '.join(numbers)})."
            if numbers
            else f"None of {len(models)} different trainings {label}s by the rules below."
        )
    small = min(models, key=lambda m: m["n_weights"])
    ratio = float((_means([small], "test") / _means([small], "train"))[0])
    if ratio > HARD:
        sentences.append(
            f"Even the smallest model's test error is {ratio:.2f} times its training error: the "
            "test blocks are harder than the training blocks, or the record is too short for any "
            "of these networks."
        )
    return sentences


def _algorithms(models: Sequence[Model]) -> list[str]:
    parts = []
    for algorithm, words in ALGORITHMS.items():
        if own := [m for m in models if m["algorithm"] == algorithm]:
            one, free = (np.median(_least(own, mode)) for mode in ("one_step", "free_run"))
            parts.append(f"{words} {one:.3g} one-step and {free:.3g} in free run")
    return [f"Median validation RMSE of the best starts by algorithm: {'; '.join(parts)}."]


def _effective_weights(models: Sequence[Model]) -> list[str]:
    parts = []
    for m in models:
        used = [n for s in m["starts"] if (n := s["effective_weights"]) is not None]
        if used:
            weights = f"{np.median(used):.0f} of the {m['n_weights']} weights"
            parts.append(f"{weights} of model {m['number']}")
    return [f"Bayesian regularisation makes use of {', '.join(parts)}."] if parts else []


def _one_step_against_free(models: Sequence[Model]) -> list[str]:
    one, free = (
        np.concatenate([errors(m, mode, "validate") for m in models])
        for mode in ("one_step", "free_run")
    )
    good = np.isfinite(one) & np.isfinite(free)
    if good.sum() < 3 or np.ptp(one[good]) == 0 or np.ptp(free[good]) == 0:
        return []
    rank = float(spearmanr(one[good], free[good]).statistic)
    near = good & (one <= UNDER * one[good].min())
    return [
        f"Over all starts the one-step and the free-run validation error have a rank correlation "
        f"of {rank:.2f}. Among the {int(near.sum())} starts whose one-step error is within "
        f"{UNDER:g} times the lowest, the free-run error varies by a factor of "
        f"{free[near].max() / free[near].min():.1f}."
    ]


def _tuning(tuned: Sequence[Model]) -> list[str]:
    pairs = [
        [t[when]["free_run"]["test"]["enabled"]["mse"] for when in ("before", "after")]
        for t in tuned
    ]
    gains = [float(np.sqrt(before / after)) for before, after in pairs if before and after]
    if not gains:
        return []
    return [
        f"Tuning in closed loop divided the free-run test RMSE of the best {len(gains)} models by "
        f"{min(gains):.2f} to {max(gains):.2f} (median {float(np.median(gains)):.2f})."
    ]
