"""Figures of the gap report: how much a new model helps, how candidates rank, what is added."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from training.gap.name.verdict import Candidate
from training.gap.response.account import ResponseCurve
from training.gap.response.drivers import UNITS, WORDS
from training.gap.verify.evidence import Error, ErrorTrace
from training.gap.verify.operating_map import OperatingMap
from training.pages.drawing import Drawing, axis, layer, plot, unscored
from training.pages.heat import Heat, over_plane
from training.pages.numbers import percent, with_unit, words

ROW: Final = 22  # px
KINDS: Final = {"effect": "measured", "sensor fault": "predicted"}


def error_figure(errors: Sequence[Error]) -> Drawing:
    """Draw RMSE before and after, and the floor, one row for each regime."""
    at = [*range(len(errors))]
    links = layer(
        "line",
        x=[x for e in errors for x in (e.before, e.after or e.before, None)],
        y=[y for i in at for y in (i, i, None)],
        color="line",
        width=2,
    )
    runs = (
        ("before", "band", [e.before for e in errors]),
        ("after", "measured", [None if e.worse else e.after for e in errors]),
        (
            "after, worse beyond confidence",
            "failed",
            [e.after if e.worse else None for e in errors],
        ),
        ("noise floor", "ink", [e.floor for e in errors]),
    )
    points = [
        layer("points", x=x, y=at, label=label, color=color, mark="|" if color == "ink" else "●")
        for label, color, x in runs
        if any(each is not None for each in x)
    ]
    changes = [i - 0.5 for i in range(1, len(errors)) if errors[i].kind != errors[i - 1].kind]
    groups = layer("rule", y=changes, color="line")
    rows = axis(rows=[e.regime for e in errors])
    height = 40 + ROW * len(errors)
    over = axis("RMSE [phi]", low=0.0)
    return Drawing([plot("RMSE by regime", groups, links, *points, x=over, y=rows, height=height)])


def trace_figure(trace: ErrorTrace) -> Drawing:
    """Draw measured phi and both models, and both residuals."""
    runs = (trace.measured, trace.before, trace.after)
    shown = np.concatenate([x[trace.scored] for x in runs])
    low, high = np.percentile(shown, [0.5, 99.5]).tolist() if len(shown) else (0.0, 1.0)
    margin = 0.15 * (high - low) + 1e-4
    models = (("model before", "band", trace.before), ("model after", "predicted", trace.after))
    grey = unscored(trace.t_s, trace.scored)
    top = plot(
        "phi",
        grey,
        *(layer("line", y=phi, label=name, color=color) for name, color, phi in models),
        layer("line", y=trace.measured, label="measured", color="measured"),
        y=axis(low=low - margin, high=high + margin),
        at=trace.t_s,
    )
    residuals = [np.where(trace.scored, trace.measured - phi, np.nan) for _, _, phi in models]
    bottom = plot(
        "measured minus predicted [phi]",
        grey,
        layer("rule", y=[0.0], color="band"),
        *(
            layer("line", y=y, label=name, color=color)
            for (name, color, _), y in zip(models, residuals, strict=True)
        ),
        x=axis(f"s of {trace.recording}"),
        at=trace.t_s,
        height=120,
    )
    return Drawing([top, bottom], together=True)


def map_figures(over: OperatingMap) -> list[tuple[str, Heat]]:
    """Return the error of each model over speed and load with its name, in the same colours."""
    shown = [("model before", over.before)]
    shown += [] if over.after is None else [("model after", over.after)]
    every = np.concatenate([error.ravel() for _, error in shown])
    corner = "air per stroke [mg] over engine speed [1/min], lower ends; phi × 1000"
    return [
        (name, over_plane(corner, over.speed_rpm, over.load_mg, 1e3 * error, ".0f", 1e3 * every))
        for name, error in shown
    ]


def ranking_figure(ranking: Sequence[Candidate], chosen: Sequence[str]) -> Drawing:
    """Draw the scores, effects and sensor faults in their colours, the chosen ones in full."""
    bars = []
    for kind, color in KINDS.items():
        own = [(i, c) for i, c in enumerate(ranking) if c.kind == kind]
        wins = [c.merit.win for _, c in own]
        bar = layer(
            "bars",
            x=[c.merit.score for _, c in own],
            y=[i for i, _ in own],
            alpha=[1.0 if c.name in chosen else 0.45 for _, c in own],
            text=["" if w is None else f"beaten in {percent(w)} of draws" for w in wins],
            label=kind,
            color=color,
        )
        bars += [bar] if own else []
    scores = [c.merit.score for c in ranking]
    low, high = min(0.0, *scores), 1.3 * max(scores)
    over = axis("fall of the deviance on held-out blocks", low=low, high=high)
    rows = axis(rows=[c.name for c in ranking])
    height = 30 + ROW * len(ranking)
    return Drawing([plot("score", *bars, x=over, y=rows, height=height)])


def label(name: str) -> str:
    """Return a signal's words with its unit."""
    return with_unit(WORDS.get(name, words(name)), UNITS.get(name))


def added_figure(curve: ResponseCurve, driver: str, unit: str) -> Drawing:
    """Draw what a driver adds to the reading."""
    zero = layer("rule", y=[0.0], color="band")
    line = layer("line", y=curve.y, label="added", color="measured", width=2)
    return Drawing([plot(f"added [{unit}]", zero, line, x=axis(label(driver)), at=curve.x)])
