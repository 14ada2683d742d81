"""The study as one self-contained page: summary first, then every part.

A section is a template below ``study/``. It gets the part's result, all parts, the figures, and
``say``, the cells and sentences that take more than a template.
"""

from collections.abc import Mapping
from typing import Any, Final

from monitor.base.counts import counted
from training.limits.data_check import findings
from training.narx.search.stability import CONTRACTION_SAMPLES
from training.pages.page import page, part
from training.study import figures, words
from training.study.narx import verdicts
from training.study.task import Parts

FALSE_ALARMS: Final = 2.0  # percent of healthy windows, two limits at quantiles of 1 %
# Sections with their part, and their title where they may be left out.
SECTIONS: Final = {
    "check": ("check", ""),
    "preparation": ("preparation", "Preparation"),
    "selection": ("selection", "Input selection"),
    "linear": ("linear", "Linear baselines"),
    "narx": ("narx", "NARX study"),
    "free": ("free", "Memory and size chosen by the data"),
    "choice": ("choice", ""),
    "closed_loop": ("choice", ""),
    "beside": ("beside", ""),
    "against_sensor": ("sensor", ""),
    "faulty": ("sensor", ""),
    "steady": ("steady", "Steady training, transient use"),
    "effort": ("effort", "How much driving a calibration takes"),
}


def report(parts: Parts, warnings: list[str]) -> str:
    """Return the page from the parts' results, as they stand in study.json."""
    choice = parts["choice"]
    return page(
        "study/report.html",
        f"Study of {choice['output']}",
        verdict=choice["reason"],
        confidence=confidence(choice),
        warnings=warnings,
        parts=parts,
        say=words,
        sections=[section(name, parts) for name in SECTIONS],
    )


def section(name: str, parts: Parts) -> str:
    """Return a section of the page, the reason where its part was left out."""
    source, title = SECTIONS[name]
    result = parts[source]
    if name == "check":
        return findings.section(result)
    if "skipped" in result:
        return part("study/skipped.html", title=title, why=result["skipped"]) if title else ""
    values = {"contraction": CONTRACTION_SAMPLES, "titles": words.TITLES, "limits": verdicts}
    return part(f"study/{name}.html", result=result, parts=parts, draw=figures, say=words, **values)


def confidence(choice: Mapping[str, Any]) -> str:
    """Return how the chosen model does on samples that chose nothing, and who is beside it."""
    own, equal = choice["candidates"][choice["chosen"]], len(choice["equal"]) - 1
    found, errors = own["after"]["all"], [c["validation_rmse"] for c in choice["candidates"]]
    is_best = own["validation_rmse"] == min(e for e in errors if e is not None)
    beside = f"no other model {'' if is_best else 'that forgets its history '}is as good"
    if equal:
        beside = f"{counted(equal, 'other')} {'is' if equal == 1 else 'are'} not told apart from it"
    if found.get("fit_percent") is None:
        return f"{beside} on the validation blocks."
    return (
        f"on {choice['test']}, which chose nothing, its free run has a fit of "
        f"{found['fit_percent']:.1f} %; {beside} on the validation blocks."
    )


def warnings(parts: Parts, titles: Mapping[str, str]) -> list[str]:
    """Return the warnings at the top of the page; ``titles`` are those of the parts."""
    found = [f["text"] for f in parts["check"]["findings"] if f["level"] == "warning"]
    found += parts["narx"].get("warnings", []) + parts["shipped"]["warnings"]
    found += [f"free structure: {text}" for text in parts["free"].get("warnings", [])]
    skipped = {name: parts[name]["skipped"] for name in titles if "skipped" in parts[name]}
    found += [f"{titles[name]}: left out, {why}" for name, why in skipped.items()]
    chosen, sensor = parts["choice"]["candidates"][parts["choice"]["chosen"]], parts["sensor"]
    fit = chosen["after"]["all"].get("fit_percent")
    if fit is None or fit <= 0.0:
        found.append("the chosen model predicts held-out samples no better than their mean would")
    false = 100 * sensor["healthy"]["beyond"]["both"]
    if false > FALSE_ALARMS:
        found.append(
            f"the paper's rule fires in {false:.1f} % of the windows of {sensor['healthy_on']} "
            "without a fault: the limits rest on other driving or weather than these"
        )
    if "skipped" not in (linear := parts["linear"]):
        own, best = parts["beside"]["fit_percent"], linear["models"][linear["best"]]["fit_percent"]
        if None not in (own, best) and own <= best:
            found.append(
                f"the chosen NARX reaches {own:.1f} % fit on held-out samples, the linear model "
                f"{words.TITLES[linear['best']]} {best:.1f} %: the NARX is not worth it"
            )
    return list(dict.fromkeys(found))
