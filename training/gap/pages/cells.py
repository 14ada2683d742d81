"""Cells of the gap report that take more than a number: changes, counts, constants."""

from collections.abc import Sequence
from typing import Final

from monitor.model.card import TrainingRecording
from training.gap.result import Result
from training.gap.verify.evidence import Count, Detection, rate
from training.greybox.effects.effect import Parameter
from training.pages.numbers import MISSING, fixed, percent

AT_BOUND: Final = 0.01  # of the range


def phi(value: float | None) -> str:
    """Return a figure in phi."""
    return fixed(value, 4)


def all_faults(faults: Sequence[Detection]) -> tuple[str, ...]:
    """Return the rates over all faults, in the columns of ``detection``."""
    before = [f.before for f in faults]
    after = [f.after for f in faults if f.after is not None]
    return (
        "all faults",
        *(percent(rate(before, of)) for of in ("judged", "found", "named")),
        *(percent(rate(after, of)) for of in ("judged", "found", "named")),
        "",
    )


def detection(f: Detection) -> tuple[str, ...]:
    """Return a fault, how often it was found and named before and after, and whether it is lost."""
    unit = {"slow": " s", "dela": " s", "bias": " lambda"}.get(f.fault[:4], "")
    words = f"{f.fault} {f.severity:g}{unit}" if f.severity is not None else f.fault
    before, after = (_counts(c, f.fault) for c in (f.before, f.after))
    return (words, *before, *after, "lost" if f.lost else "")


def _counts(c: Count | None, fault: str) -> tuple[str, str, str]:
    if c is None:
        return (MISSING, MISSING, MISSING)
    right = f"{c.named} of {c.drives}" if fault else ", ".join(sorted(set(c.codes))) or "no code"
    return (f"{c.judged} of {c.drives}", f"{c.found} of {c.drives}", right)


def at_bound(parameter: Parameter, value: float) -> bool:
    """Return whether a constant ran to the end of its range."""
    margin = AT_BOUND * (parameter.high - parameter.low)
    return not parameter.low + margin < value < parameter.high - margin


def recordings(result: Result) -> list[tuple[str, TrainingRecording]]:
    """Return every recording after the use that was made of it."""
    given = result.inputs
    groups = {"verifies": given.verify, "looked at": given.recordings, "healthy": given.healthy}
    return [(role, r) for role, group in groups.items() for r in group]
