"""How sure the gap report is of its verdict, in one sentence."""

from training.gap.name.posterior import NONE
from training.gap.result import Result
from training.pages.numbers import percent


def confidence(result: Result) -> str:
    """Return the two likeliest hypotheses with their probabilities."""
    ordered = sorted(result.naming.posterior.items(), key=lambda each: -each[1])[:2]
    named = [("no gap" if name == NONE else name.replace("_", " "), p) for name, p in ordered]
    words = ", ".join(f"{percent(p)} for {name}" for name, p in named)
    if words:
        return f"of all hypotheses, {words}."
    if result.verdict == "no_gap":
        return "the error is what chance and healthy driving explain; no effect could be tried."
    return "no effect could be tried; the parts below say how far each answer is beyond chance."
