"""The section about the NARX study: all models, figures, and the findings in words."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from training.narx.stability import CONTRACTION_SAMPLES
from training.pages.numbers import unbroken
from training.pages.page import part
from training.study.narx import narx_figures
from training.study.narx.candidates import PAPER
from training.study.narx.narx_figures import ROLES
from training.study.narx.verdicts import correlations, errors

STOPS = {
    "validation": "validation",
    "epochs": "limit",
    "gradient": "gradient",
    "mu": "no step",
    "damping": "no step",
    "budget": "time",
}


def section(result: dict[str, Any]) -> str:
    """Return the section from the study's result."""
    return part(
        "study/narx.html",
        result=result,
        paper=PAPER,
        contraction=CONTRACTION_SAMPLES,
        row=_row,
        tuned_row=_tuned_row,
        draw=narx_figures,
    )


def _row(model: Mapping[str, Any]) -> tuple[str, ...]:
    name = unbroken(f"{model['number']}  {model['name']}")
    if model["origin"] == PAPER:
        name += unbroken(" (paper)")
    if model["same_as"] is not None:
        same = unbroken(f"same training as {model['same_as']}")
        return (name, str(model["n_weights"]), same, *[""] * 8)
    starts = model["starts"]
    free = errors(model, "free_run", "test")
    finite = len(free) > 1 and bool(np.isfinite(free).all())
    spread = f"{100 * free.std(ddof=1) / free.mean():.0f} %" if finite else ""
    stops = sorted({STOPS.get(s["stop"], s["stop"]) for s in starts})
    return (
        name,
        str(model["n_weights"]),
        _r_cell(model, "one_step"),
        f"{np.median(errors(model, 'one_step', 'test') ** 2):.2g}",
        _r_cell(model, "free_run"),
        f"{np.median(free**2):.2g}",
        ", ".join(model["verdict"]["labels"]) or "–",
        spread,
        _iterations(model),
        unbroken(", ".join(stops)),
        f"{np.mean([s['cpu_s'] for s in starts]):.1f}",
    )


def _iterations(model: Mapping[str, Any]) -> str:
    counts = sorted({s["iterations"] for s in model["starts"]})
    return "–".join(map(str, counts[:: max(1, len(counts) - 1)]))


def _r_cell(model: Mapping[str, Any], mode: str) -> str:
    medians = [np.median(correlations(model, mode, role)) for role in ROLES]
    return unbroken(" / ".join(f"{m:.3f}" for m in medians))


def _tuned_row(tuned: Mapping[str, Any]) -> tuple[str, ...]:
    cells = [unbroken(f"{tuned['number']}  {tuned['name']}")]
    for what in ("r", "mse"):
        for role in ("validate", "test"):
            values = [tuned[w]["free_run"][role]["enabled"][what] for w in ("before", "after")]
            roots = [v if v is None or what == "r" else float(np.sqrt(v)) for v in values]
            cells.append(unbroken(" → ".join("none" if v is None else f"{v:.4f}" for v in roots)))
    forgets = " → ".join("yes" if tuned[w]["forgets"] else "no" for w in ("before", "after"))
    return (*cells, unbroken(forgets), _best_stage(tuned), f"{tuned['cpu_s']:.0f}")


def _best_stage(tuned: Mapping[str, Any]) -> str:
    """Return the stage whose weights were kept: the first that reached the final score."""
    final, first = (tuned[w]["validation_score"] for w in ("after", "before"))
    if final is None or final == first:
        return "none"
    names = [s["name"] for s in tuned["stages"] if s["best_score"] == final]
    return names[0] if names else str(tuned["stages"][-1]["name"])
