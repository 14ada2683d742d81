"""Cells of the gap report that take more than a number: changes, counts, constants."""

from collections.abc import Mapping, Sequence
from typing import Final

from monitor.model.card import TrainingRecording
from training.gap.result import Result
from training.gap.verify.evidence import Count, Detection, Error, rate
from training.greybox.effects import LIBRARY
from training.greybox.effects.empirical import effect_of, is_empirical
from training.greybox.effects.form.effect import Parameter
from training.greybox.fit.sensor_faults import FAULTS
from training.pages.numbers import MISSING, fixed, percent, unit_of

AT_BOUND: Final = 0.01  # of the range
KNOWN: Final[Mapping[str, tuple[Parameter, ...]]] = {
    **{name: effect.parameters for name, effect in LIBRARY.items()},
    **{fault.name: fault.parameters for fault in FAULTS},
}


def parameters_of(name: str) -> tuple[Parameter, ...]:
    """Return the constants of an effect or sensor fault, also of a formula's term."""
    return effect_of(name).parameters if is_empirical(name) else KNOWN.get(name, ())


def phi(value: float | None) -> str:
    """Return a figure in phi."""
    return fixed(value, 4)


def change(e: Error) -> str:
    """Return the change of an error in thousandths with its bounds."""
    if e.after is None:
        return MISSING
    if e.change_low is None or e.change_high is None:
        return "too few blocks"
    parts = (1e3 * each for each in (e.after - e.before, e.change_low, e.change_high))
    return "{:+.1f} ({:+.1f} to {:+.1f})".format(*parts)


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


def values(
    name: str,
    parameters: Mapping[str, float],
    standard_errors: Mapping[str, float],
    units: Mapping[str, str],
) -> str:
    """Return constants with standard errors in one line; one at its bound says so."""
    bounds = {p.name: p for p in parameters_of(name)}
    return "; ".join(
        f"{p} {value:.3g} ± {standard_errors.get(p, float('nan')):.2g} "
        f"{unit_of(units.get(p, ''))}".rstrip()
        + (", at its bound" if p in bounds and at_bound(bounds[p], value) else "")
        for p, value in parameters.items()
    )


def at_bound(parameter: Parameter, value: float) -> bool:
    """Return whether a constant ran to the end of its range."""
    margin = AT_BOUND * (parameter.high - parameter.low)
    return not parameter.low + margin < value < parameter.high - margin


def recordings(result: Result) -> list[tuple[str, TrainingRecording]]:
    """Return every recording after the use that was made of it."""
    groups: tuple[tuple[str, tuple[TrainingRecording, ...]], ...] = (
        ("verifies", result.inputs.verify),
        ("looked at", result.inputs.recordings),
        ("healthy", result.inputs.healthy),
    )
    return [(role, r) for role, group in groups for r in group]
