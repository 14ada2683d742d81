"""How sure the gap report is of its verdict, in one sentence."""

from training.gap.name.posterior import NONE
from training.gap.result import Result
from training.pages.numbers import percent


def confidence(result: Result) -> str:
    """Return the likeliest hypothesis with its probability."""
    for name, p in result.naming.posterior.items():  # the likeliest first
        words = "no gap" if name == NONE else name.replace("_", " ")
        return f"of all hypotheses, {percent(p)} for {words}."
    if result.verdict == "no_gap":
        return "the error is what chance and healthy driving explain; no effect could be tried."
    return "no effect could be tried; the parts below say how far each answer is beyond chance."
