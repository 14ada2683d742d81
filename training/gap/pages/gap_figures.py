"""Figures of the gap report: how much a new model helps, the hypotheses, where the error is."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from training.gap.response.account import ResponseCurve
from training.gap.response.drivers import UNITS, name_of
from training.gap.verify.error_curve import ErrorCurve
from training.gap.verify.evidence import Error, ErrorTrace
from training.pages.drawing import Drawing, axis, layer, plot, unscored
from training.pages.numbers import with_unit, words

ROW: Final = 19  # px
SHOWN: Final = 8  # hypotheses
SHOWN_LEAST: Final = 0.001  # probability


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


def posterior_figure(posterior: Mapping[str, float], chosen: Sequence[str]) -> Drawing:
    """Draw the probabilities of the likeliest hypotheses, the chosen ones in full."""
    shown = [(name, p) for name, p in posterior.items() if p >= SHOWN_LEAST][:SHOWN]
    bars = layer(
        "bars",
        x=[p for _, p in shown],
        y=[*range(len(shown))],
        alpha=[1.0 if name in chosen else 0.45 for name, _ in shown],
        color="measured",
    )
    rows = axis(rows=[words(name) for name, _ in shown])
    over, height = axis("probability", low=0.0, high=1.0), 30 + ROW * len(shown)
    return Drawing([plot("hypotheses", bars, x=over, y=rows, height=height)])


def curve_figure(curve: ErrorCurve) -> Drawing:
    """Draw the mean error before and after over the variable on which it depends most."""
    shown = (("before", "band", curve.before), ("after", "measured", curve.after))
    lines = [
        layer("line", y=y, label=name, color=color, width=2)
        for name, color, y in shown
        if y is not None
    ]
    zero = layer("rule", y=[0.0], color="line")
    over = axis(label(curve.driver))
    return Drawing([plot("measured minus predicted [phi]", zero, *lines, x=over, at=curve.at)])


def label(name: str) -> str:
    """Return a signal's words with its unit."""
    return with_unit(name_of(name), UNITS.get(name))


def added_figure(curve: ResponseCurve, driver: str, unit: str) -> Drawing:
    """Draw what a driver adds to the reading."""
    zero = layer("rule", y=[0.0], color="band")
    line = layer("line", y=curve.y, label="added", color="measured", width=2)
    return Drawing([plot(f"added [{unit}]", zero, line, x=axis(label(driver)), at=curve.x)])
