"""The page of one training: its warnings, tries, figures and free runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from monitor.base.files.outputs import write_text
from training.narx.cross_fit import unseen_words
from training.narx.fit import FitResult
from training.narx.network import describe
from training.narx.page import free_run_figures
from training.narx.page.fit_confidence import fit_confidence
from training.narx.page.fit_verdict import fit_verdict
from training.pages.figure import drawing
from training.pages.page import page


def write_report(path: Path | str, result: FitResult) -> None:
    """Write the page; figures are embedded, nothing is loaded from elsewhere."""
    members = result.starts[result.best].members
    spec = result.network.spec
    one = replace(spec, hidden=tuple(n // members for n in spec.hidden))
    verdict, kind = fit_verdict(result.card)
    text = page(
        "training.html",
        f"Training of {result.path.name}",
        verdict=verdict,
        confidence=fit_confidence(result),
        kind=kind,
        warnings=result.warnings,
        result=result,
        card=result.card,
        shape=describe(spec),
        trainings=sum(t.members == 1 for t in result.starts),
        members=members,
        tries=sorted(result.tries, key=lambda t: t.rmse),
        is_chosen=lambda t: t.structure.spec(result.data) == one,
        unseen=result.card.fit.get("unseen"),
        unseen_words=unseen_words,
        curves=_training_curves(result),
        draw=free_run_figures,
    )
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)


def _training_curves(result: FitResult) -> Figure:
    figure, axes = drawing(3.2)
    for index, start in enumerate(result.starts):
        at = 0
        for stage in start.stages:
            scores = np.array(stage.scores) * result.data.scaling.y_std
            label = f"start {index + 1}" if at == 0 else None
            if label and index == result.best:
                label += ", chosen"
            axes.semilogy(np.arange(at, at + len(scores)), scores, color=f"C{index}", label=label)
            if index == result.best:
                axes.axvline(at, color="0.85", linewidth=0.8)
                name = " " + stage.name.removeprefix("horizon ")
                axes.text(
                    at,
                    0.98,
                    name,
                    transform=axes.get_xaxis_transform(),
                    va="top",
                    size=8,
                    color="0.4",
                )
            at += len(scores) - 1
    unit = result.card.output.unit
    axes.set(
        xlabel="epoch; the numbers on top are the horizons in samples",
        ylabel="free-run RMSE" + (f", {unit}" if unit not in ("", "-") else ""),
    )
    axes.legend(frameon=False)
    return figure
