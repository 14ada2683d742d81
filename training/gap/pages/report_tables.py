"""Tables of the gap report: errors, detection, candidates, constants, recordings."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from monitor.model.card import TrainingRecording
from training.gap.name.verdict import Candidate
from training.gap.result import Result
from training.gap.verify.evidence import Count, Detection, Error, Verification, rate
from training.greybox.chain import RANGES, Constants
from training.greybox.effects import LIBRARY
from training.greybox.effects.form.effect import Parameter
from training.greybox.fit.sensor_faults import FAULTS
from training.pages.page import table

NONE: Final = "–"
AT_BOUND: Final = 0.01  # of the range
SHOWN: Final = 8  # candidates before the rest folds away
KNOWN: Final[Mapping[str, tuple[Parameter, ...]]] = {
    **{name: effect.parameters for name, effect in LIBRARY.items()},
    **{fault.name: fault.parameters for fault in FAULTS},
}


def phi(value: float | None) -> str:
    """Return a figure in phi."""
    return NONE if value is None else f"{value:.4f}"


def percent(value: float | None) -> str:
    """Return a share in percent."""
    return NONE if value is None else f"{value:.0%}"


def errors_table(verified: Verification) -> str:
    """Return RMSE before, after and floor: all samples, each regime, healthy recordings."""
    healthy = [] if verified.healthy is None else [verified.healthy]
    rows = [_error(e) for e in (verified.overall, *verified.regimes, *healthy)]
    head = ("regime", "samples", "before", "after", "floor", "change × 1000 (95 %)", "")
    return table(rows, head, chosen=0)


def _error(e: Error) -> tuple[str, ...]:
    if e.after is None:
        change = NONE
    elif e.change_low is None or e.change_high is None:
        change = "too few blocks"
    else:
        parts = (1e3 * each for each in (e.after - e.before, e.change_low, e.change_high))
        change = "{:+.1f} ({:+.1f} to {:+.1f})".format(*parts)
    mark = "worse" if e.worse else "better" if e.better else ""
    return (e.regime, f"{e.samples:,}", phi(e.before), phi(e.after), phi(e.floor), change, mark)


def detection_table(verified: Verification) -> str:
    """Return how often each fault was found and named before and after, then the false alarms."""
    rows = [_found(f) for f in verified.faults]
    before = [f.before for f in verified.faults]
    after = [f.after for f in verified.faults if f.after is not None]
    alike = [f.alike for f in verified.faults if f.alike is not None]
    rows.append(
        (
            "all faults",
            *(_rates(before, of) for of in ("judged", "found", "named")),
            *(_rates(alike, of) for of in ("found", "named")),
            *(_rates(after, of) for of in ("judged", "found", "named")),
            "",
        )
    )
    alarms = (
        ("no fault, held-out drives", verified.alarms),
        ("no fault, healthy recordings", verified.healthy_alarms),
    )
    rows += [(words, *_found(f)[1:]) for words, f in alarms if f is not None]
    head = (
        "put on the reading",
        "judged before",
        "found",
        "named right",
        "found with limits set alike",
        "named right",
        "judged after",
        "found",
        "named right",
        "",
    )
    return table(rows, head, chosen=len(verified.faults))


def _found(f: Detection) -> tuple[str, ...]:
    unit = {"slow": " s", "dela": " s", "bias": " lambda"}.get(f.fault[:4], "")
    words = f"{f.fault} {f.severity:g}{unit}" if f.severity is not None else f.fault
    before, alike, after = (_count(c, f.fault) for c in (f.before, f.alike, f.after))
    return (words, *before, *alike[1:], *after, "lost" if f.lost else "")


def _count(c: Count | None, fault: str) -> tuple[str, str, str]:
    if c is None:
        return (NONE, NONE, NONE)
    right = f"{c.named} of {c.drives}" if fault else ", ".join(sorted(set(c.codes))) or "no code"
    return (f"{c.judged} of {c.drives}", f"{c.found} of {c.drives}", right)


def _rates(counts: Sequence[Count], of: str) -> str:
    return percent(rate(counts, of))


def candidates_table(ranking: Sequence[Candidate], chosen: Iterable[str]) -> str:
    """Return candidates with score, t, adequacy and margin, chosen ones marked.

    Constants are impossible that have the wrong sign, or size and form at the edge of their ranges.
    """
    names = set(chosen)
    rows = [
        (
            f"{'→ ' if c.name in names else ''}{c.name}",
            c.tag,
            f"{c.score:.0f}",
            f"{c.needed:.0f}",
            f"{c.t:.1f}",
            "possible" if c.physical else "impossible",
            percent(c.adequacy),
            "the best" if c.win is None else percent(c.win),
            ", ".join(c.like) or NONE,
        )
        for c in ranking
    ]
    head = (
        "candidate",
        "kind",
        "score",
        "needed",
        "t",
        "constants",
        "adequacy",
        "beaten in",
        "same class",
    )
    return table(rows, head)


def fitted_table(ranking: Sequence[Candidate]) -> str:
    """Return what each candidate would be, with its constants."""
    rows = [
        (c.name, c.says, values(c.name, c.parameters, c.standard_errors, c.units)) for c in ranking
    ]
    return table(rows, ("candidate", "what it is", "constants"))


def values(
    name: str,
    parameters: Mapping[str, float],
    standard_errors: Mapping[str, float],
    units: Mapping[str, str],
) -> str:
    """Return constants with standard errors in one line; one at its bound says so."""
    bounds = {p.name: p for p in KNOWN.get(name, ())}
    return "; ".join(
        f"{p} {value:.3g} ± {standard_errors.get(p, float('nan')):.2g} "
        f"{_unit(units.get(p, ''))}".rstrip()
        + (", at its bound" if p in bounds and at_bound(bounds[p], value) else "")
        for p, value in parameters.items()
    )


def at_bound(parameter: Parameter, value: float) -> bool:
    """Return whether a constant ran to the end of its range."""
    margin = AT_BOUND * (parameter.high - parameter.low)
    return not parameter.low + margin < value < parameter.high - margin


def constants_table(result: Result) -> str:
    """Return the constants of what was added or is ambiguous, as they stand in the model."""
    own = {a.name: a for a in result.added}
    rows = []
    for c in result.effects:
        source = own.get(c.name, c)
        for p in KNOWN[c.name]:
            value = source.parameters[p.name]
            rows.append(
                (
                    f"{c.name}: {p.name}",
                    f"{value:.4g}",
                    f"{source.standard_errors[p.name]:.2g}",
                    _unit(p.unit),
                    f"{p.low:g} to {p.high:g}" + (", reached" if at_bound(p, value) else ""),
                )
            )
    return table(rows, ("constant", "value", "standard error", "unit", "bounds"))


def base_table(base: Constants, reference: Constants | None, shift: Constants | None) -> str:
    """Return the base's constants beside their healthy reference."""
    rows = []
    for i, (name, value) in enumerate(base._asdict().items()):
        known = NONE if reference is None else f"{reference[i]:.4f}"
        moved = NONE if shift is None else f"{shift[i]:+.4f}"
        rows.append((name, known, f"{value:.4f}", moved, _unit(RANGES[name].unit)))
    head = (
        "base constant",
        "healthy reference",
        "with what was added",
        "shift if refitted alone",
        "unit",
    )
    return table(rows, head)


def recordings_table(result: Result) -> str:
    """Return every recording, what it served for, and its sha256."""
    groups: tuple[tuple[str, tuple[TrainingRecording, ...]], ...] = (
        ("held out", result.held_out),
        ("looked at", result.recordings),
        ("healthy", result.healthy),
    )
    rows = [
        (r.path, role, r.source or "not said", f"{r.samples:,}", r.sha256[:16])
        for role, group in groups
        for r in group
    ]
    return table(rows, ("recording", "served as", "source", "samples", "sha256 begins"))


def _unit(unit: str) -> str:
    return "" if unit in ("-", "") else unit
