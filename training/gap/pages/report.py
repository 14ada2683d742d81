"""The gap report: one page for a review, the verdict first."""

import html
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

from training.gap.name.verdict import Candidate
from training.gap.pages.report_figures import error_figure, ranking_figure, trace_figure
from training.gap.pages.report_tables import (
    SHOWN,
    base_table,
    candidates_table,
    constants_table,
    detection_table,
    errors_table,
    fitted_table,
    phi,
    recordings_table,
)
from training.gap.pages.report_words import actions, cautions, verdict_sentence
from training.gap.pages.where_section import section as where_section
from training.gap.result import Result
from training.pages.page import page, paragraph, picture, table

SECTIONS: Final = (
    ("now", "What now"),
    ("much", "How much"),
    ("what", "What"),
    ("where", "Where"),
    ("steps", "Steps"),
    ("from", "Recordings and model"),
)
SCORES: Final = (
    "Score: fall of the deviance on held-out blocks. t: of the blocks' signed square roots. "
    "Adequacy: share of what can be explained at all, worked out for the first few. Beaten in: how "
    "often resampled blocks prefer the best."
)
FLOOR: Final = (
    "The noise floor is what a flexible model, with plain functions of all signals and every "
    "candidate's signature, leaves of the same samples, each block by a fit without it. The floor "
    "under Where is of other recordings, from repeated operating points."
)
PACKAGES: Final = ("numpy", "scipy", "onnx", "onnxruntime")


def as_page(result: Result) -> str:
    """Return the whole page as HTML; nothing is loaded from elsewhere."""
    links = "".join(f'<a href="#{name}">{title}</a>' for name, title in SECTIONS)
    bodies = (_now, _much, _what, _where, _steps, _from)
    body = [paragraph(verdict_sentence(result), f"verdict {result.verdict}"), f"<nav>{links}</nav>"]
    for (name, title), make in zip(SECTIONS, bodies, strict=True):
        body.append(f'<h2 id="{name}">{title}</h2>')
        body.append(make(result))
    return page(f"Model gap: {result.model.path.name}", "\n".join(body))


def save(result: Result, path: Path) -> None:
    """Write the page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(as_page(result), encoding="utf-8")


def _now(result: Result) -> str:
    items = "".join(f"<li>{html.escape(text)}</li>" for text in actions(result))
    warnings = "".join(f'<li class="warning">{html.escape(t)}</li>' for t in cautions(result))
    listed = f"<h3>Warnings</h3><ul>{warnings}</ul>" if warnings else ""
    return f"<ul>{items}</ul>" + _experiment(result) + listed


def _experiment(result: Result) -> str:
    experiment = result.naming.experiment
    if experiment is None:
        return ""
    ordered = sorted(experiment.difference.items(), key=lambda each: -each[1])
    rows = [(name, phi(rms)) for name, rms in ordered]
    return table(rows, ("manoeuvre", "the candidates differ by, RMS in phi"), chosen=0)


def _much(result: Result) -> str:
    verified = result.verified
    before, after, floor, measured_on = result.rmse
    rows = [("before", phi(before)), ("after", phi(after)), ("noise floor", phi(floor))]
    if verified is not None and verified.healthy is not None:
        rows.append(("before, on healthy recordings", phi(verified.healthy.before)))
    parts = [table(rows, ("RMSE in phi = 1 / lambda, outside fuel cut", measured_on))]
    if result.tried:
        parts.append(paragraph(FLOOR, "note"))
    if verified is None:
        words = "no recording was kept from the fits. Give --verify, or more recordings."
        if not result.tried:
            words = "nothing was fitted and nothing added."
        parts.append(paragraph(f"Not verified: {words}", "warning" if result.tried else "note"))
        return "".join(parts)
    if verified.trace is not None:
        words = "The stretch in which the new model helps most; grey: not scored"
        parts.append(picture(trace_figure(verified.trace), words))
    errors = (verified.overall, *verified.regimes)
    parts.append(picture(error_figure(errors), "Errors by regime on recordings that no fit saw"))
    parts.append(errors_table(verified))
    parts.append(
        paragraph(
            "The change is in thousandths of phi. Its bounds hold for all regimes together, those "
            "of all samples by themselves; from a bootstrap over blocks of 30 s. Speed and load "
            "are cut into thirds of the samples; edges are where the old model's phi is steep.",
            "note",
        )
    )
    if verified.faults:
        parts += ["<h3>Faults put on the reading</h3>", detection_table(verified)]
    parts += [paragraph(note, "note") for note in verified.notes]
    return "".join(parts)


def _what(result: Result) -> str:
    naming, parts = result.naming, []
    if result.effects:
        parts.append(constants_table(result))
        classes = [f"{c.name}: {', '.join(c.like)}" for c in result.effects if c.like]
        if classes:
            parts.append(paragraph(f"Cannot be told apart by construction: {'; '.join(classes)}."))
    if result.form:
        parts.append(paragraph(result.form))
    if result.unknown:
        parts.append(paragraph(result.unknown))
    for title, ranking in _rankings(result):
        parts.append(f"<h3>{html.escape(title)}</h3>")
        parts.append(_ranking(ranking, [c.name for c in result.effects]))
    if result.tried:
        parts.append(paragraph(SCORES, "note"))
    if naming.skipped:
        rows = [(name, ", ".join(signals)) for name, signals in naming.skipped.items()]
        parts += ["<h3>Not looked at</h3>", table(rows, ("candidate", "signals that are missing"))]
    if naming.base is not None:
        parts += ["<h3>Base</h3>", base_table(naming.base, naming.reference, naming.base_shift)]
    return "".join(parts)


def _rankings(result: Result) -> list[tuple[str, tuple[Candidate, ...]]]:
    """Return the ranking of each step, the last one too if nothing came of it."""
    found = [(f"Ranking: {s.added}", s.ranking) for s in result.steps if s.added and s.ranking]
    last = result.naming.ranking
    if last and all(ranking != last for _, ranking in found):
        found.append(("Ranking of the last step" if found else "Ranking", last))
    return found


def _ranking(ranking: Sequence[Candidate], chosen: Sequence[str]) -> str:
    first, rest = ranking[:SHOWN], ranking[SHOWN:]
    words = "Effects and the sensor faults that rival them; in full colour what was chosen"
    more = candidates_table(rest, chosen) if rest else ""
    return (
        picture(ranking_figure(first, chosen), words)
        + candidates_table(first, chosen)
        + f"<details><summary>{f'{len(rest)} more, and ' if rest else ''}what each would be"
        + f"</summary>{more}{fitted_table(ranking)}</details>"
    )


def _where(result: Result) -> str:
    if result.findings is None:
        return paragraph("Not localised.")
    return where_section(result.findings).replace("<h2>", "<h3>").replace("</h2>", "</h3>")


def _steps(result: Result) -> str:
    if not result.steps:
        return paragraph("Nothing was added.")
    rows = [(step.added or "the model as it came", phi(step.rmse)) for step in result.steps]
    return table(rows, ("added", "RMSE in phi after it"))


def _from(result: Result) -> str:
    model = result.model
    took = "" if result.seconds is None else f" It took {result.seconds:.0f} s."
    used = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return recordings_table(result) + paragraph(
        f"Model: {model.path} ({model.kind}), sha256 {model.sha256}. "
        f"The sensor was {'' if result.sensor_known_good else 'not '}declared good.{took} "
        f"Packages: {used}.",
        "note",
    )
