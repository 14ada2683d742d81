"""The page of a study of the gap workflow, for as many cases as there are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from benchmarks.studies.sensor.detection_figures import confusion_figure
from benchmarks.studies.workflow import tables
from benchmarks.studies.workflow.answers import done, large
from benchmarks.studies.workflow.case import ADD, RETRAIN_MINUTES, Row
from benchmarks.studies.workflow.gap_study_result import ERRORS_SHOWN, cells, hidden, reached
from benchmarks.studies.workflow.plan import HEALTHY_DRIVES, Study
from benchmarks.studies.workflow.targets import Target, assess
from training.gap.inputs.base import GREYBOX
from training.pages.page import page, template_of

MISSED_SHOWN: Final = 3
FINAL: Final = 5000  # vehicles with lower numbers serve development
TEMPLATES: Final = Path(__file__).parents[1] / "templates"


def as_page(rows: Sequence[Row], study: Study, identity: dict[str, Any]) -> str:
    """Return the page of a study."""
    noises = [r["noise"] for r in rows if r["noise"] is not None]
    targets = assess(rows, study.base)
    retrained = study.fitted_with_effect and study.base != GREYBOX
    return page(
        template_of(TEMPLATES / "gap_study.html"),
        f"Simulated study of the gap workflow, base {study.base}",
        verdict=f"{_verdict(targets)} {reached(rows, study)}.",
        confidence=_confidence(targets),
        kind="bad" if any(t.met is False for t in targets) else "good" if rows else "",
        study=study,
        is_development=study.first_vehicle < FINAL,
        noise=f"{min(noises):.4f} to {max(noises):.4f}" if noises else "not known",
        healthy_drives=HEALTHY_DRIVES,
        retrain_s=60.0 * RETRAIN_MINUTES if retrained else None,
        add=ADD,
        targets=[cells(target) for target in targets],
        two=tables.two(rows),
        confusion=tables.confusion(rows) if rows else None,
        confusions=_confusions(rows),
        by_size=tables.by_size(rows),
        wrong=tables.wrong(rows),
        errors=[r for r in rows if r["error"] is not None],
        errors_shown=ERRORS_SHOWN,
        hidden=hidden,
        footer=[f"Code {identity['code_sha256'][:12]}"],
    )


def _verdict(targets: Sequence[Target]) -> str:
    """Return how many targets are met, and which one is missed most plainly."""
    judged = [t for t in targets if t.met is not None]
    missed = [t for t in judged if not t.met]
    text = f"{len(judged) - len(missed)} of {len(judged)} targets are met."
    if not missed:
        return text
    return f"{text} Missed: {'; '.join(f'{t.where}: {t.what}' for t in missed[:MISSED_SHOWN])}."


def _confidence(targets: Sequence[Target]) -> str:
    """Return how many of the met targets are proved."""
    met = [t for t in targets if t.met]
    return (
        f"{sum(bool(t.proved) for t in met)} of {len(met)} met targets are proved (their 95 % "
        "bounds meet them, too); the others need more cases. Everything here is simulated."
    )


def _confusions(rows: Sequence[Row]) -> list[tuple[str, Figure]]:
    """Return a picture of hidden and answered: of all cases, and of those with a large gap."""
    some = {"all cases": rows, "cases whose gap is at least twice the noise": large(done(rows))}
    drawn = []
    for which, cases in some.items():
        if cases:
            figure = confusion_figure(tables.confusion(cases))
            figure.axes[0].set(xlabel="answered", ylabel="hidden")
            drawn.append((which, figure))
    return drawn
