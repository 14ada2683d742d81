"""The NARX study as HTML: the table of all models, figures, and what the numbers say."""

import html
from collections.abc import Mapping
from typing import Any

import numpy as np

from training.narx.stability import CONTRACTION_SAMPLES
from training.pages.page import paragraph, table
from training.studies.paper.narx.candidates import PAPER
from training.studies.paper.narx.figures import ROLES, correlation_figure, free_run_figure
from training.studies.paper.narx.verdicts import correlations, errors

STOPS = {
    "validation": "validation",
    "epochs": "limit",
    "gradient": "gradient",
    "mu": "no step",
    "damping": "no step",
    "budget": "time",
}


def section(result: dict[str, Any]) -> str:
    """Return the part of the report, headed by h2."""
    return "\n".join(
        [
            f"<h2>NARX study: {len(result['models'])} models</h2>",
            *_introduction(result),
            *(paragraph(w, "warning") for w in result["warnings"]),
            correlation_figure(result),
            *(paragraph(f) for f in result["findings"]),
            "<h3>All models</h3>",
            _table(result),
            "<h3>Over- and underfitting</h3>",
            _verdicts(result),
            *(paragraph(r, "note") for r in result["rules"]),
            "<h3>One step ahead and in free run</h3>",
            free_run_figure(result),
            *_tuned(result),
        ]
    )


def _introduction(result: Mapping[str, Any]) -> list[str]:
    samples, settings = result["samples"], result["settings"]
    data = {
        "simulated": "simulated recordings",
        "recorded": "recordings of real engines",
    }.get(result["source"], f"recordings ({result['source']})")
    own = sum(m["origin"] == PAPER for m in result["models"])
    text = [
        f"{result['output']} from {', '.join(result['inputs'])}, {data}, sample period "
        f"{result['period_s'] * 1000:g} ms. {samples['training']} of "
        f"{samples['training_available']} training samples were used, whole blocks spread evenly "
        f"over the recordings; {samples['validation']} validate, {samples['test']} test. "
        f"{settings['starts']} starts per model, at most {settings['iterations']} iterations, "
        "early stopping after six validation failures (Bayesian regularisation has none).",
        f"The paper does not list its models. {own} of these is known to be the paper's (marked), "
        "the others were chosen here within its ranges: 3, 5 and 8 lags, one or two hidden layers "
        "of 5 to 15 neurons, its four algorithms. Only gradient descent has a learning rate; "
        "models that differ in nothing else are one training and carry its number.",
    ]
    share = samples["enabled_share"]
    if share < 1.0:
        text.append(
            f"Correlation R and mean squared error are taken where the monitor judges (enabled: "
            f"closed loop, no fuel cut, sensor ready; {100 * share:.0f} % of the samples), because "
            "fuel cut alone brings R near 1. Errors are in scaled units: the standard deviation of "
            "the output over all training samples is 1."
        )
    else:
        text.append(
            "Errors are in scaled units: the standard deviation of the output over the training "
            "samples is 1."
        )
    return [paragraph(t) for t in text]


def _table(result: Mapping[str, Any]) -> str:
    head = (
        "model",
        "weights",
        "R one-step",
        "MSE",
        "R free run",
        "MSE",
        "verdict",
        "spread",
        "iterations",
        "stop",
        "s",
    )
    chosen = next(
        (i for i, m in enumerate(result["models"]) if m["number"] == result["best"]["number"]), None
    )
    text = table([_row(m) for m in result["models"]], head, chosen)
    note = (
        "SCG: scaled conjugate gradient, GD: gradient descent with momentum and adaptive rate. "
        "(paper): known to be the paper's, the others are chosen here. R: training / validation / "
        "test, MSE: test, median over the starts. Spread: standard deviation of the free-run test "
        "RMSE over the starts, in percent of its mean. Stop: validation (six failures), limit (of "
        "iterations), no step (lowers the error). s: processor seconds per start. Set off: the "
        "architecture that validates best in free run after closed-loop tuning."
    )
    return f'<div style="font-size:80%">{text}</div>' + paragraph(note, "note")


def _row(model: Mapping[str, Any]) -> tuple[str, ...]:
    name = _unbroken(f"{model['number']}  {model['name']}")
    if model["origin"] == PAPER:
        name += _unbroken(" (paper)")
    if model["same_as"] is not None:
        same = _unbroken(f"same training as {model['same_as']}")
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
        _unbroken(", ".join(stops)),
        f"{np.mean([s['cpu_s'] for s in starts]):.1f}",
    )


def _verdicts(result: Mapping[str, Any]) -> str:
    lines = [
        f"<li>{m['number']}  {m['name']}: <b>{', '.join(m['verdict']['labels'])}</b> "
        f"({html.escape(m['verdict']['words'])}).</li>"
        for m in result["models"]
        if m["verdict"]["labels"] and m["same_as"] is None
    ]
    return f"<ul>{''.join(lines)}</ul>" if lines else paragraph("No model is remarkable.")


def _iterations(model: Mapping[str, Any]) -> str:
    counts = sorted({s["iterations"] for s in model["starts"]})
    return "–".join(map(str, counts[:: max(1, len(counts) - 1)]))


def _r_cell(model: Mapping[str, Any], mode: str) -> str:
    medians = [np.median(correlations(model, mode, role)) for role in ROLES]
    return _unbroken(" / ".join(f"{m:.3f}" for m in medians))


def _unbroken(text: str) -> str:
    return text.replace(" ", "\N{NO-BREAK SPACE}").replace("-", "\N{NON-BREAKING HYPHEN}")


def _tuned(result: Mapping[str, Any]) -> list[str]:
    if not result["tuned"]:
        return []
    horizons = ", ".join(map(str, result["settings"]["horizons"]))
    text = (
        f"The best {len(result['tuned'])} models by free-run validation (models that coincide "
        "count once, the best start of each) were trained on in closed loop: Levenberg–Marquardt "
        f"on the simulation error with exact sensitivities, horizons {horizons} samples, the "
        "stage with the lowest free-run validation error kept. Figures before → after in free "
        "run; test blocks chose nothing. Forgets: predictions from any two histories agree after "
        f"{CONTRACTION_SAMPLES} samples; a model that does not is used only if none does."
    )
    head = (
        "model",
        "R validation",
        "R test",
        "RMSE validation",
        "RMSE test",
        "forgets",
        "best stage",
        "s",
    )
    chosen = next(
        (
            i
            for i, t in enumerate(result["tuned"])
            if t["number"] == result["best"]["number"] and result["best"]["tuned"]
        ),
        None,
    )
    rows = [_tuned_row(t) for t in result["tuned"]]
    return [
        "<h3>The best models, tuned in closed loop</h3>",
        paragraph(text),
        f'<div style="font-size:80%">{table(rows, head, chosen)}</div>',
    ]


def _tuned_row(tuned: Mapping[str, Any]) -> tuple[str, ...]:
    cells = [_unbroken(f"{tuned['number']}  {tuned['name']}")]
    for what in ("r", "mse"):
        for role in ("validate", "test"):
            values = [tuned[w]["free_run"][role]["enabled"][what] for w in ("before", "after")]
            roots = [v if v is None or what == "r" else float(np.sqrt(v)) for v in values]
            cells.append(_unbroken(" → ".join("none" if v is None else f"{v:.4f}" for v in roots)))
    forgets = " → ".join("yes" if tuned[w]["forgets"] else "no" for w in ("before", "after"))
    return (*cells, _unbroken(forgets), _best_stage(tuned), f"{tuned['cpu_s']:.0f}")


def _best_stage(tuned: Mapping[str, Any]) -> str:
    """Return the stage whose weights were kept: the first that reached the final score."""
    final, first = (tuned[w]["validation_score"] for w in ("after", "before"))
    if final is None or final == first:
        return "none"
    names = [s["name"] for s in tuned["stages"] if s["best_score"] == final]
    return names[0] if names else str(tuned["stages"][-1]["name"])
