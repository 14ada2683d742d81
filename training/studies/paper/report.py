"""The study as one self-contained page: summary first, then every part."""

import re
from collections.abc import Mapping
from typing import Any

from training.limits.data_check import page as check_page
from training.pages.page import page, paragraph, table
from training.studies.paper import outcome_page
from training.studies.paper.linear import page as linear_page
from training.studies.paper.narx import page as narx_page
from training.studies.paper.outcome import paper_figures
from training.studies.paper.preparation import page as preparation_page
from training.studies.paper.selection import page as selection_page

_HEADING = re.compile(r"<h2>(.*?)</h2>", re.DOTALL)
_SECTIONS = {
    "check": lambda part: "<h2>Is the data enough?</h2>" + check_page.body(part),
    "preparation": preparation_page.section,
    "selection": selection_page.section,
    "linear": linear_page.section,
    "narx": narx_page.section,
}
_SKIPPED = {
    "preparation": "Preparation",
    "selection": "Input selection",
    "linear": "Linear baselines",
    "narx": "NARX study",
    "free": "Memory and size chosen by the data",
    "steady": "Steady training, transient use",
}


def report(parts: Mapping[str, Any], warnings: list[str]) -> str:
    """Return the page from the parts' results, as they stand in study.json."""
    sections = []
    for name in ("check", "preparation", "selection", "linear", "narx"):
        part = parts[name]
        sections.append(_skipped(name, part) if "skipped" in part else _SECTIONS[name](part))
    free = parts["free"]
    sections.append(_skipped("free", free) if "skipped" in free else outcome_page.free(free))
    sections.append(outcome_page.choice(parts))
    sections += [outcome_page.closed_loop(parts["choice"]), outcome_page.beside(parts)]
    sections += [outcome_page.against_sensor(parts["sensor"]), outcome_page.faulty(parts["sensor"])]
    steady = parts["steady"]
    sections.append(
        _skipped("steady", steady) if "skipped" in steady else outcome_page.steady(steady)
    )
    body = "\n".join([_summary(parts, warnings), *sections])
    titles: list[str] = []

    def anchored(found: re.Match[str]) -> str:
        titles.append(found[1])
        return f'<h2 id="part{len(titles)}">{found[1]}</h2>'

    body = _HEADING.sub(anchored, body)
    links = "".join(f'<li><a href="#part{i}">{t}</a></li>' for i, t in enumerate(titles, 1))
    return page(_title(parts), f"<nav><ol>{links}</ol></nav>\n{body}")


def _title(parts: Mapping[str, Any]) -> str:
    return f"Study of {parts['choice']['output']}"


def _skipped(name: str, part: Mapping[str, Any]) -> str:
    return f"<h2>{_SKIPPED[name]}</h2>" + paragraph(f"Left out: {part['skipped']}.", "warning")


def _summary(parts: Mapping[str, Any], warnings: list[str]) -> str:
    choice, sensor, data = parts["choice"], parts["sensor"], parts["data"]
    drives = [
        (d["use"], d["path"], d["source"], str(d["samples"]), d["sha256"][:12])
        for d in data["recordings"]
    ]
    out = [
        "<h2>Summary</h2>",
        *(paragraph(w, "warning") for w in warnings),
        paragraph(_what(data)),
        paragraph(choice["reason"]),
        table(
            _views(sensor),
            (
                "free run of the chosen model",
                "source",
                "samples",
                "R",
                "fit, %",
                f"RMSE{_unit(sensor)}",
                "fit, all samples, %",
            ),
        ),
        paragraph(_judged(data, sensor), "note"),
        paragraph(
            f"The paper chose {paper_figures.LAGS} lags and two layers of eight with "
            f"Levenberg–Marquardt at rate {paper_figures.RATE}: MSE {paper_figures.MSE}, R "
            + ", ".join(f"{r:.3f} {k}" for k, r in paper_figures.R.items())
            + "."
        ),
        "<h3>The paper's numbers beside ours</h3>",
        _paper(parts),
        "<h3>Recordings</h3>",
        outcome_page.small(table(drives, ("use", "recording", "source", "samples", "sha256"))),
    ]
    return "\n".join(out)


def _what(data: Mapping[str, Any]) -> str:
    return (
        f"{data['output']} from {', '.join(data['inputs'])}, every {data['period_s']:g} s; "
        f"{data['samples']} samples to train and choose on, {data['source']}. "
        f"The chosen model is in model.onnx, every number of this page in study.json."
    )


def _judged(data: Mapping[str, Any], sensor: Mapping[str, Any]) -> str:
    """Return which samples the figures are of, and which drives no step saw."""
    if data["conditions"]:
        names = ", ".join(data["conditions"])
        text = f"R, fit and RMSE are of the samples that the monitor judges, by {names}."
    else:
        text = "All samples: the recordings do not say where the monitor would judge."
    if sensor["healthy_on"] == "held-out drives":
        return f"{text} The last rows are drives that no step of the study saw."
    return f"{text} No held-out drives were given (--test): test blocks of the same drives judge."


def _unit(sensor: Mapping[str, Any]) -> str:
    return f", {sensor['unit']}" if sensor["unit"] not in ("", "-") else ""


def _views(sensor: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            v["title"],
            v["source"],
            *outcome_page.figures(v["enabled"]),
            outcome_page.number(v["all"].get("fit_percent"), ".1f"),
        )
        for v in sensor["views"]
    ]


def _paper(parts: Mapping[str, Any]) -> str:
    rows = paper_figures.beside_ours(parts)
    own = paper_figures.same_structure(parts)
    if own:
        rows.append(own)
    note = (
        f"The paper's recordings are not public; ours are {parts['data']['source']}, as their "
        "manifests say (no manifest: recorded). The numbers stand beside each other and are not "
        "one experiment."
    )
    shown = outcome_page.text_table(rows, ("", "paper", "here"))
    return shown + paragraph(note, "note")
