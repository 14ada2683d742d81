"""The NARX study as HTML: the table of all models, figures, and what the numbers say."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from training.page import paragraph, picture, table
from training.study.candidates import ALGORITHMS, BAYES, DESCENT, HERE, PAPER
from training.study.narx_verdicts import correlations, errors

ROLES = {"train": "training", "validate": "validation", "test": "test"}
MARKS = {"train": "o", "validate": "s", "test": "^"}
COLOURS = dict(zip(ALGORITHMS, ("#1f5fa8", "#c2571a", "#3b8a4e", "#8a5aa8"), strict=True))
ORIGINS = {PAPER: "paper", HERE: "here"}
STOPS = {
    "validation": "validation",
    "epochs": "limit",
    "gradient": "gradient",
    "mu": "no step",
    "damping": "no step",
    "budget": "time",
}
NO_BREAK = "\N{NO-BREAK SPACE}"
R_FLOOR = 0.5  # correlations below are drawn at the lower edge


def section(result: dict[str, Any]) -> str:
    """Return the part of the report, headed by h2."""
    return "\n".join(
        [
            f"<h2>NARX study: {len(result['models'])} models</h2>",
            *_introduction(result),
            *(paragraph(w, "warning") for w in result["warnings"]),
            _figure_5(result),
            *(paragraph(f) for f in result["findings"]),
            "<h3>All models</h3>",
            _table(result),
            "<h3>Over- and underfitting</h3>",
            _verdicts(result),
            *(paragraph(r, "note") for r in result["rules"]),
            "<h3>One step ahead and in free run</h3>",
            _figure_one_step_against_free(result),
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
    head = ("model", "from", "weights", "R one-step", "MSE", "R free run", "MSE", "verdict",
            "spread", "iterations", "stop", "s")  # fmt: skip
    chosen = next(
        (i for i, m in enumerate(result["models"]) if m["number"] == result["best"]["number"]), None
    )
    rows = [tuple(c.replace(" ", NO_BREAK) for c in _row(m)) for m in result["models"]]
    text = table(rows, head, chosen)
    note = (
        "SCG: scaled conjugate gradient, GD: gradient descent with momentum and adaptive rate. "
        "From: known to be the paper's, or chosen here. R: training / validation / test, MSE: "
        "test, median over the starts. Spread: standard deviation of the free-run test RMSE over "
        "the starts, in percent of its mean. Stop: validation (six failures), limit (of "
        "iterations), no step (lowers the error). s: processor seconds per start. Set off: the "
        "architecture that validates best in free run after closed-loop tuning."
    )
    return f'<div style="font-size:85%">{text}</div>' + paragraph(note, "note")


def _row(model: Mapping[str, Any]) -> tuple[str, ...]:
    name = f"{model['number']}  {model['name']}"
    if model["same_as"] is not None:
        same = f"same training as {model['same_as']}"
        return (name, ORIGINS[model["origin"]], str(model["n_weights"]), same, *[""] * 8)
    starts = model["starts"]
    free = errors(model, "free_run", "test")
    finite = len(free) > 1 and bool(np.isfinite(free).all())
    spread = f"{100 * free.std(ddof=1) / free.mean():.0f} %" if finite else ""
    stops = sorted({STOPS.get(s["stop"], s["stop"]) for s in starts})
    return (
        name,
        ORIGINS[model["origin"]],
        str(model["n_weights"]),
        _r_cell(model, "one_step"),
        f"{np.median(errors(model, 'one_step', 'test') ** 2):.2g}",
        _r_cell(model, "free_run"),
        f"{np.median(free**2):.2g}",
        ", ".join(model["verdict"]["labels"]) or "–",
        spread,
        "–".join(str(f([s["iterations"] for s in starts])) for f in (min, max)),
        ", ".join(stops),
        f"{np.mean([s['cpu_s'] for s in starts]):.1f}",
    )


def _verdicts(result: Mapping[str, Any]) -> str:
    judged = [m for m in result["models"] if m["verdict"]["labels"] and m["same_as"] is None]
    rows = [
        (f"{m['number']}  {m['name']}", ", ".join(m["verdict"]["labels"]), m["verdict"]["words"])
        for m in judged
    ]
    return table(rows, ("model", "verdict", "because")) if rows else ""


def _r_cell(model: Mapping[str, Any], mode: str) -> str:
    return " / ".join(f"{np.median(correlations(model, mode, role)):.3f}" for role in ROLES)


def _figure_5(result: Mapping[str, Any]) -> str:
    """Draw R of training, validation and test and the MSE of every model, as the paper does."""
    models = [m for m in result["models"] if m["same_as"] is None]
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes: list[Axes] = list(figure.subplots(3, 1, sharex=True))
    for axis, mode, title in zip(axes, ("one_step", "free_run"), _TITLES.values(), strict=False):
        _draw_correlations(axis, models, mode)
        axis.set(title=title, ylabel="R")
    axes[0].legend(ncols=3, frameon=False, loc="lower left")
    _draw_mse(axes[2], models)
    axes[2].set_xticks(range(len(models)), [_tick(m) for m in models], rotation=90, fontsize=8)
    caption = (
        f"Correlation and mean squared error of every model ({result['source']} data, enabled "
        "samples): median over the starts, bars from the worst to the best start. Correlations "
        f"below {R_FLOOR:g} stand at the lower edge. Number, algorithm, lags, layers, rate."
    )
    return picture(figure, caption)


_TITLES = {"one_step": "one step ahead", "free_run": "free run (closed loop)"}


def _draw_correlations(axis: Axes, models: Sequence[Mapping[str, Any]], mode: str) -> None:
    lowest = 1.0
    for shift, role in zip((-0.22, 0.0, 0.22), ROLES, strict=True):
        values = [np.nan_to_num(correlations(m, mode, role), nan=R_FLOOR) for m in models]
        clipped = [np.clip(v, R_FLOOR, 1.0) for v in values]
        middle = np.array([np.median(v) for v in clipped])
        bars = np.array([[m - v.min(), v.max() - m] for m, v in zip(middle, clipped, strict=True)])
        at = np.arange(len(models)) + shift
        colour = {"train": "#1f5fa8", "validate": "#c2571a", "test": "#3b8a4e"}[role]
        axis.errorbar(
            at, middle, bars.T, fmt=MARKS[role], ms=4, lw=1, color=colour, label=ROLES[role]
        )
        lowest = min(lowest, float(min(v.min() for v in clipped)))
    axis.set_ylim(max(R_FLOOR, lowest - 0.1 * (1 - lowest)) - 1e-4, 1 + 0.08 * (1 - lowest) + 1e-4)
    axis.grid(axis="y", alpha=0.3)


def _draw_mse(axis: Axes, models: Sequence[Mapping[str, Any]]) -> None:
    at = np.arange(len(models))
    for mode, shift, colour in (("one_step", -0.2, "#9db8d9"), ("free_run", 0.2, "#1f5fa8")):
        values = np.array([np.median(errors(m, mode, "test") ** 2) for m in models])
        values[~np.isfinite(values)] = np.nan
        axis.bar(at + shift, values, 0.4, color=colour, label=_TITLES[mode])
    axis.set(yscale="log", ylabel="MSE of the test blocks, scaled", title="mean squared error")
    axis.legend(ncols=2, frameon=False)
    axis.grid(axis="y", alpha=0.3)


def _tick(model: Mapping[str, Any]) -> str:
    algorithm = "BR" if model["algorithm"] == BAYES else model["algorithm"]
    rate = f" {model['rate']:g}" if algorithm == DESCENT and model["rate"] is not None else ""
    layers = "-".join(map(str, model["hidden"]))
    return f"{model['number']}  {algorithm} {model['lags']} {layers}{rate}"


def _figure_one_step_against_free(result: Mapping[str, Any]) -> str:
    models = [m for m in result["models"] if m["same_as"] is None]
    figure = Figure(figsize=(7, 5), layout="constrained")
    axis = figure.subplots()
    for algorithm, words in ALGORITHMS.items():
        own = [m for m in models if m["algorithm"] == algorithm]
        if own:
            one = np.concatenate([errors(m, "one_step", "validate") for m in own])
            free = np.concatenate([errors(m, "free_run", "validate") for m in own])
            axis.plot(one, free, "o", ms=5, alpha=0.7, color=COLOURS[algorithm], label=words)
    for index, tuned in enumerate(result["tuned"]):
        ends = [_point(tuned[when]) for when in ("before", "after")]
        if all(np.isfinite(e).all() for e in ends):
            axis.annotate("", ends[1], ends[0], arrowprops={"arrowstyle": "->", "lw": 1})
            axis.plot(*ends[1], "*", ms=10, color="black",
                      label="after closed-loop tuning" if index == 0 else None)  # fmt: skip
    low, high = axis.get_xlim()
    axis.plot([low, high], [low, high], ":", color="#888888", label="equal")
    axis.set(xscale="log", yscale="log", xlabel="one-step RMSE on validation blocks, scaled",
             ylabel="free-run RMSE on validation blocks, scaled")  # fmt: skip
    axis.legend(frameon=False, fontsize=9)
    axis.grid(alpha=0.3)
    return picture(
        figure,
        f"Every start of every model ({result['source']} data, enabled samples). Only the free "
        "run is what the monitor uses; a low one-step error does not promise it.",
    )


def _point(figures: Mapping[str, Any]) -> tuple[float, float]:
    values = [figures[m]["validate"]["enabled"]["mse"] for m in ("one_step", "free_run")]
    one, free = (np.nan if v is None else float(np.sqrt(v)) for v in values)
    return one, free


def _tuned(result: Mapping[str, Any]) -> list[str]:
    if not result["tuned"]:
        return []
    horizons = ", ".join(map(str, result["settings"]["horizons"]))
    text = (
        f"The best {len(result['tuned'])} models by free-run validation (models that coincide "
        "count once, the best start of each) were trained on in closed loop: Levenberg–Marquardt "
        f"on the simulation error with exact sensitivities, horizons {horizons} samples, the "
        "stage with the lowest free-run validation error kept. Test blocks chose nothing."
    )
    rows = [tuple(c.replace(" ", NO_BREAK) for c in _tuned_row(t)) for t in result["tuned"]]
    head = ("model", "R validation before", "after", "R test before", "after",
            "RMSE validation before", "after", "RMSE test before", "after", "best stage",
            "s")  # fmt: skip
    chosen = next(
        (i for i, t in enumerate(result["tuned"])
         if t["number"] == result["best"]["number"] and result["best"]["tuned"]), None,
    )  # fmt: skip
    return [
        "<h3>The best models, tuned in closed loop</h3>",
        paragraph(text),
        f'<div style="font-size:85%">{table(rows, head, chosen)}</div>',
    ]


def _tuned_row(tuned: Mapping[str, Any]) -> tuple[str, ...]:
    cells = [f"{tuned['number']}  {tuned['name']}"]
    for what, form in (("r", "{:.4f}"), ("mse", "{:.4f}")):
        for role in ("validate", "test"):
            for when in ("before", "after"):
                value = tuned[when]["free_run"][role]["enabled"][what]
                value = value if value is None or what == "r" else float(np.sqrt(value))
                cells.append("diverges" if value is None else form.format(value))
    best = min(tuned["stages"], key=lambda s: np.inf if (v := s["best_score"]) is None else v)
    return (*cells, best["name"], f"{tuned['cpu_s']:.0f}")
