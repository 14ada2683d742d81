"""The study as one self-contained page: summary first, then every part."""

from collections.abc import Mapping
from typing import Any, Final

from training.limits.data_check import findings
from training.pages.numbers import short
from training.pages.page import page, part
from training.study import model_figures
from training.study.linear import linear_section
from training.study.narx import narx_section
from training.study.outcome import paper_figures
from training.study.outcome.comparison import TITLES
from training.study.preparation import preparation_section
from training.study.selection import selection_section

SECTIONS: Final = {
    "check": ("Is the data enough?", findings.section),
    "preparation": ("Preparation", preparation_section.section),
    "selection": ("Input selection", selection_section.section),
    "linear": ("Linear baselines", linear_section.section),
    "narx": ("NARX study", narx_section.section),
}


def report(parts: Mapping[str, Any], warnings: list[str]) -> str:
    """Return the page from the parts' results, as they stand in study.json."""
    sections = [
        part("study/skipped.html", title=title, why=parts[name]["skipped"])
        if "skipped" in parts[name]
        else section(parts[name])
        for name, (title, section) in SECTIONS.items()
    ]
    output = parts["choice"]["output"]
    own = paper_figures.same_structure(parts)
    return page(
        "study/report.html",
        f"Study of {output}",
        verdict=parts["choice"]["reason"],
        confidence=_confidence(parts["choice"]),
        warnings=warnings,
        parts=parts,
        data=parts["data"],
        sensor=parts["sensor"],
        paper=paper_figures,
        beside_ours=[*paper_figures.beside_ours(parts), *([own] if own else [])],
        sections=sections,
        outcome=[
            _or_skipped("free", "Memory and size chosen by the data", parts),
            outcome("choice", parts=parts),
            outcome("closed_loop", result=parts["choice"]),
            "" if "skipped" in parts["beside"] else _beside(parts),
            outcome("against_sensor", sensor=parts["sensor"]),
            faulty(parts["sensor"]),
            _or_skipped("steady", "Steady training, transient use", parts),
        ],
    )


def _confidence(choice: Mapping[str, Any]) -> str:
    """Return how the chosen model does on samples that chose nothing, and who is beside it."""
    own = choice["candidates"][choice["chosen"]]
    found = (own.get("after") or own.get("before") or {}).get("all") or {}
    equal = len(choice["equal"]) - 1
    beside = (
        "no other model is as good" if not equal else f"{equal} others are not told apart from it"
    )
    if found.get("fit_percent") is None:
        return f"{beside} on the validation blocks."
    return (
        f"on {choice['test']}, which chose nothing, its free run has a fit of "
        f"{found['fit_percent']:.1f} %; {beside} on the validation blocks."
    )


def outcome(name: str, /, **values: Any) -> str:
    """Return a section about the chosen model."""
    return part(f"study/{name}.html", draw=model_figures, **values)


def faulty(sensor: Mapping[str, Any]) -> str:
    """Return the section about residuals, healthy and faulty."""
    return outcome("faulty", sensor=sensor, rule=_rule(sensor))


def _or_skipped(name: str, title: str, parts: Mapping[str, Any]) -> str:
    if "skipped" in parts[name]:
        return part("study/skipped.html", title=title, why=parts[name]["skipped"])
    return outcome(name, result=parts[name])


def _beside(parts: Mapping[str, Any]) -> str:
    result, choice = parts["beside"], parts["choice"]
    regime = result["regime"]
    return outcome(
        "beside",
        result=result,
        output=choice["output"],
        is_phi=parts["preparation"]["transform"] == "phi",
        name=choice["candidates"][choice["chosen"]]["name"],
        titles=TITLES,
        ranges=[span(low, high) for low, high in regime["ranges"]] if regime else [],
    )


def span(low: float | None, high: float | None) -> str:
    """Return a range in words."""
    if low is None:
        return f"below {short(high)}" if high is not None else "all"
    return f"from {short(low)}" if high is None else f"{short(low)} to {short(high)}"


def _rule(sensor: Mapping[str, Any]) -> str:
    """Return how often the paper's rule fires, in words."""
    if "j_mu" not in sensor["limits"] or not sensor["faults"]:
        return ""
    healthy = 100 * sensor["healthy"]["beyond"]["both"]
    shares = sorted(100 * f["beyond"]["both"] for f in sensor["faults"])
    form = ".0f" if shares[-1] >= 10 else ".1f"
    return (
        f"It fires in {healthy:.1f} % of the healthy windows and in {shares[0]:{form}} to "
        f"{shares[-1]:{form}} % of the windows under a fault. It cannot say which fault; the "
        "monitor's response rule can."
    )
