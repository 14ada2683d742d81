"""How sure the gap report is of its verdict, in one sentence."""

from training.gap.name.posterior import NONE
from training.gap.name.verdict import Candidate
from training.gap.result import Result
from training.pages.numbers import percent


def confidence(result: Result) -> str:
    """Return the likeliest hypotheses, how far the best is beyond chance, and beyond the next."""
    return f"{_likeliest(result)}{_beyond_chance(result)}"


def _likeliest(result: Result) -> str:
    """Return the two likeliest hypotheses with their probabilities, "" if none were weighed."""
    ordered = sorted(result.naming.posterior.items(), key=lambda each: -each[1])[:2]
    named = [("no gap" if name == NONE else name.replace("_", " "), p) for name, p in ordered]
    words = ", ".join(f"{percent(p)} for {name}" for name, p in named)
    return f"of all hypotheses, {words}; " if words else ""


def _beyond_chance(result: Result) -> str:
    """Return how far the best candidate is beyond chance, and beyond the next one."""
    ranking = _ranking(result)
    if not ranking:
        if result.verdict == "no_gap":
            return "the error is what chance and healthy driving explain; no effect could be tried."
        return "no effect could be tried; the parts below say how far each answer is beyond chance."
    best, *others = ranking
    score, needed = best.merit.score, best.merit.needed
    if result.verdict == "no_gap":
        return (
            f"the nearest candidate, {best.name}, reaches a score of {max(score, 0.0):.0f}, and "
            f"{needed:.0f} is beyond what healthy drives reach."
        )
    text = (
        f"the best candidate, {best.name}, has a score of {score:.0f}, and {needed:.0f} is beyond "
        f"what healthy drives reach (t {best.merit.t:.1f})"
    )
    second = next((each for each in others if each.merit.win is not None), None)
    if second is None or second.merit.win is None:
        return f"{text}."
    return f"{text}; {percent(second.merit.win)} of resampled drives prefer it to {second.name}."


def _ranking(result: Result) -> tuple[Candidate, ...]:
    """Return the ranking from which the verdict came: of the last effect that was named."""
    trials = result.naming.trials
    last = trials.rounds[-1].ranking if trials.rounds else ()
    return last or trials.ranking
