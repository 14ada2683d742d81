"""The result of a study as JSON, as the lines that the command prints, and as a page."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any, Final

import monitor
from training.gap.inputs.base import GREYBOX
from training.pages.page import page, paragraph, picture, table
from training.studies.gap import tables
from training.studies.gap.answers import CLASSES, done, large
from training.studies.gap.case import ADD, RETRAIN_MINUTES, Row
from training.studies.gap.plan import HEALTHY_DRIVES, Study
from training.studies.gap.targets import Target, assess
from training.studies.matrix.figures import confusion_figure

SCHEMA: Final = "o2train.gap-study/1"
PACKAGES: Final = ("numpy", "scipy", "numba")
HEAD: Final = ("target", "wanted", "found", "95 % bounds", "cases", "")
FINAL: Final = 5000  # vehicles with lower numbers serve development
ERRORS_SHOWN: Final = 20


def result(rows: Sequence[Row], study: Study, identity: dict[str, Any]) -> dict[str, Any]:
    """Return the whole result of a study."""
    return {
        "schema": SCHEMA,
        "source": "simulated",
        **identity,
        "packages": {name: metadata.version(name) for name in PACKAGES}
        | {"o2-monitor": monitor.__version__},
        "reached": len(rows),
        "planned": planned(study),
        "errors": sum(r["error"] is not None for r in rows),
        "targets": [
            asdict(t) | {"met": t.met, "proved": t.proved} for t in assess(rows, study.base)
        ],
        "two": tables.two(rows),
        "confusion": tables.confusion(rows),
        "by_size": [asdict(cell) for cell in tables.by_size(rows)],
        "wrong": [
            {k: r[k] for k in ("number", "kind", "vehicle", "hidden", "fault", "names")}
            for r in tables.wrong(rows)
        ],
    }


def planned(study: Study) -> int:
    """Return how many cases a study holds."""
    return sum(number for _, number in study.cases)


def as_text(rows: Sequence[Row], study: Study) -> str:
    """Return reached, targets, wrong names and errors as lines."""
    lines = [reached(rows, study)]
    for target in assess(rows, study.base):
        what, want, got, bounds, cases, verdict = cells(target)
        lines.append(f"{what}: {got} ({bounds}) of {cases}, wanted {want}: {verdict}")
    if found := tables.two(rows):
        lines.append("two effects: " + ", ".join(f"{n} {what}" for what, n in found.items()))
    big = [c for c in tables.by_size(rows) if c.size == CLASSES[2]]
    if big:
        each = ", ".join(f"{c.effect} {c.right}/{c.cases}" for c in big)
        lines.append(f"named rightly at a gap of at least twice the noise: {each}")
    lines += [
        f"wrong name: case {r['number']}, {_what(r)}, gap {r['gap_over_noise']:.1f} times the "
        f"noise: {' + '.join(r['names'])}"
        for r in tables.wrong(rows)
    ]
    errors = Counter(r["error"] for r in rows if r["error"] is not None)
    lines += [f"error in {n} cases: {error}" for error, n in errors.most_common(ERRORS_SHOWN)]
    return "\n".join(lines)


def reached(rows: Sequence[Row], study: Study) -> str:
    """Return how far the study came."""
    errors = sum(r["error"] is not None for r in rows)
    failed = f", {errors} of them ended in an error and answer nothing" if errors else ""
    return (
        f"{len(rows)} of {planned(study)} simulated cases reached, base {study.base}, "
        f"{study.vehicles} vehicles{failed}"
    )


def cells(target: Target) -> tuple[str, str, str, str, str, str]:
    """Return a target as cells: what and where, wanted, found, bounds, cases, verdict."""
    sign = "≥" if target.at_least else "≤"
    return (
        f"{target.where}: {target.what}",
        f"{sign} {_number(target, target.wanted)}",
        _number(target, target.found),
        f"{_number(target, target.low)} to {_number(target, target.high)}",
        str(target.cases),
        target.verdict,
    )


def as_page(rows: Sequence[Row], study: Study, identity: dict[str, Any]) -> str:
    """Return the page of a study, for as many cases as there are."""
    body = [
        _head(rows, study, identity),
        f"<h2>Targets, base {study.base}, simulated</h2>",
        table([cells(t) for t in assess(rows, study.base)], HEAD),
        paragraph(
            "Bounds are two-sided 95 %: of shares after Clopper and Pearson, of quantiles order "
            "statistics. They count cases as independent, though a vehicle has several and all "
            "its cases share what its healthy recordings taught.",
            "note",
        ),
        _two(rows),
        _confusion(rows),
        _by_size(rows),
        _wrong(rows),
        _errors(rows),
    ]
    return page(f"Simulated study of the gap workflow, base {study.base}", "\n".join(body))


def _head(rows: Sequence[Row], study: Study, identity: dict[str, Any]) -> str:
    last = study.first_vehicle + study.vehicles - 1
    developed = (
        "Vehicles with such low numbers serve development, so these figures are not final. "
        if study.first_vehicle < FINAL
        else ""
    )
    noises = [r["noise"] for r in rows if r["noise"] is not None]
    noise = f"{min(noises):.4f} to {max(noises):.4f}" if noises else "not known"
    return "\n".join(
        [
            paragraph(f"Everything here is simulated. {reached(rows, study)}."),
            paragraph(
                f"Vehicles {study.first_vehicle} to {last}, seeds from {study.seed}. {developed}"
                f"A case is {study.drives} recordings of {study.duration_s / 60.0:g} minutes each, "
                "values as decoded from the vehicle's bus at 100 ms, about half of them from "
                "the start of the engine, the others from the midst of a drive. What is hidden "
                "acts in the plant's own form inside the lambda control loop. The base is fitted "
                "to "
                + (
                    "the case's own recordings, but those that the workflow holds out"
                    if study.fitted_with_effect
                    else "the healthy ones"
                )
                + f"; {HEALTHY_DRIVES} healthy recordings of the vehicle, with other seeds, are "
                "given."
                + (" The sensor is declared good." if study.sensor_known_good else "")
                + (
                    f" The network may be trained anew for {60.0 * RETRAIN_MINUTES:g} s."
                    if study.fitted_with_effect and study.base != GREYBOX
                    else ""
                )
            ),
            paragraph(
                "The gap of a case is how far what is hidden moves the error of the base that was "
                "fitted to the vehicle's healthy recordings: the RMS of the difference between its "
                "error on the drives and on the same drives and seeds with nothing hidden, over "
                "samples scored in both. The noise is what the naming's ceiling leaves of the "
                f"residual of the healthy recordings, {noise} in phi. Gap closed is the share that "
                "the new model takes away of the excess squared error on recordings that it was "
                "not fitted to, 0 where nothing is added; the excess is over the same base, fitted "
                "alike, on the same drives with nothing hidden. Effects that may be faults are "
                f"added, too ({', '.join(ADD)}), as if the user had said that they are none. "
                "Faults are put on the measured lambda of the held-out recordings afterwards."
            ),
            paragraph(f"Code {identity['code_sha256'][:12]}.", "note"),
        ]
    )


def _two(rows: Sequence[Row]) -> str:
    found = tables.two(rows)
    if not found:
        return ""
    lines = [(what, str(number)) for what, number in found.items()]
    return "<h2>Two effects at once, simulated</h2>" + table(lines, ("answer", "cases"))


def _confusion(rows: Sequence[Row]) -> str:
    if not rows:
        return ""
    found = tables.confusion(rows)
    used = [j for j in range(len(found["named"])) if any(c[j] for c in found["counts"])]
    lines = [
        (what, *(str(counts[j] or "") for j in used), str(sum(counts)))
        for what, counts in zip(found["driven"], found["counts"], strict=True)
    ]
    head = ("hidden", *(found["named"][j] for j in used), "cases")
    parts = ["<h2>Hidden and answered</h2>", _matrix(found, "all cases")]
    if big := large(done(rows)):
        parts.append(_matrix(tables.confusion(big), "cases whose gap is at least twice the noise"))
    return "".join([*parts, table(lines, head)])


def _matrix(found: dict[str, Any], which: str) -> str:
    figure = confusion_figure(found)
    figure.axes[0].set(xlabel="answered", ylabel="hidden")
    return picture(figure, f"Simulated, {which}: answers in percent of each row")


def _by_size(rows: Sequence[Row]) -> str:
    lines = [
        (c.effect, c.size, str(c.cases), str(c.right), str(c.among), str(c.wrong), c.verdicts)
        for c in tables.by_size(rows)
    ]
    head = ("effect", "gap", "cases", "right", "right or ambiguous", "wrong name", "not named")
    return "<h2>By effect and size of the gap, simulated</h2>" + table(lines, head) if lines else ""


def _wrong(rows: Sequence[Row]) -> str:
    lines = [
        (
            str(r["number"]),
            str(r["vehicle"]),
            _what(r),
            f"{r['gap_over_noise']:.1f}",
            " + ".join(r["names"]),
            f"{r['runner_up']}, {'-' if r['win'] is None else format(r['win'], '.2f')}",
        )
        for r in tables.wrong(rows)
    ]
    head = ("case", "vehicle", "hidden", "gap / noise", "named", "runner-up, win over it")
    title = "<h2>Wrong names, simulated</h2>"
    return title + (table(lines, head) if lines else paragraph("None."))


def _what(row: Row) -> str:
    """Return the hidden effects or fault with severity."""
    if row["fault"]:
        return f"{row['kind']}: {row['fault']} {row['fault_severity']:g}"
    effects = zip(row["hidden"], row["severities"], strict=True)
    return " + ".join(f"{name} {severity:g}" for name, severity in effects) or "nothing"


def _errors(rows: Sequence[Row]) -> str:
    bad = [r for r in rows if r["error"] is not None]
    if not bad:
        return ""
    lines = [(str(r["number"]), r["kind"], r["error"]) for r in bad[:ERRORS_SHOWN]]
    return f"<h2>Errors, {len(bad)} cases</h2>" + table(lines, ("case", "kind", "error"))


def _number(target: Target, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{100.0 * value:.1f} %" if target.unit == "share" else f"{value:.1f} s"
