"""The page of one training: its warnings, tries, figures and free runs."""

from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.files.outputs import write_text
from training.narx.fit import FitResult
from training.narx.model_file import FreeRunFit
from training.narx.network import describe
from training.narx.page import free_run_figures
from training.narx.page.fit_verdict import fit_confidence, fit_verdict
from training.pages.drawing import Drawing, axis, layer, plot
from training.pages.numbers import with_unit
from training.pages.page import page


def write_report(path: Path | str, result: FitResult) -> None:
    """Write the page; figures are embedded, nothing is loaded from elsewhere."""
    chosen = {(each.spec, each.decay) for each in result.chosen.members}
    write_page(
        path,
        result,
        "fit/training.html",
        f"Training of {result.path.name}",
        shape=describe(result.chosen.model.spec),
        trainings=sum(t.members == 1 for t in result.chosen.starts),
        members=len(result.chosen.members),
        tries=result.tries,
        is_chosen=lambda t: (t.trained[0].spec, t.trained[0].decay) in chosen,
        unseen=result.card.fit.get("unseen"),
        curves=_training_curves(result),
    )


def write_page(
    path: Path | str, result: FreeRunFit, template: str, title: str, **values: Any
) -> None:
    """Write the page of any kind of fit; ``values`` are for its own template."""
    verdict, kind = fit_verdict(result.card)
    text = page(
        template,
        title,
        verdict=verdict,
        confidence=fit_confidence(result),
        kind=kind,
        warnings=result.warnings,
        result=result,
        card=result.card,
        draw=free_run_figures,
        **values,
    )
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)


def _training_curves(result: FitResult) -> Drawing:
    """Draw the error of each start over its epochs, and the horizons of the best one."""
    starts = [start for start in result.chosen.starts if start.stages]  # a mean has no epochs
    # a stage begins where the one before it ended
    parts = (
        [*(s.scores[:-1] for s in each.stages), each.stages[-1].scores[-1:]] for each in starts
    )
    runs = [*map(np.concatenate, parts)]
    at = np.arange(max(map(len, runs)), dtype=np.float64)
    lines = []
    for index, scores in enumerate(runs):
        y = np.full(len(at), np.nan)
        y[: len(scores)] = scores * result.data.scaling.y_std
        name = f"start {index + 1}" + (", chosen" if starts[index] is result.chosen.model else "")
        lines.append(layer("line", y=y, label=name, color=index))
    stages = result.chosen.best_member.stages
    begins = np.cumsum([0, *(len(stage.scores) - 1 for stage in stages)])[: len(stages)]
    names = [stage.name.removeprefix("horizon ") for stage in stages]
    horizons = layer("rule", x=begins, text=names, color="quiet", width=0.7)
    title = with_unit("free-run RMSE", result.card.output.unit)
    return Drawing([plot(title, horizons, *lines, x=axis("epoch"), y=axis(scale="log"), at=at)])
