"""The section on linear baselines: words, tables and figures from the stored result."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.page import paragraph, picture, table

Result = dict[str, Any]

TITLES = {
    "arx_sum_of_squares": "ARX, sum of squares",
    "arx_mdl": "ARX, MDL",
    "arx_aic": "ARX, AIC",
    "arx_free_run": "ARX, free run",
    "subspace": "state space",
    "output_error": "output error",
}
COLOURS = {"arx_free_run": "C0", "subspace": "C2", "output_error": "C1"}


def section(result: Result) -> str:
    """Return the HTML of this part from what ``linear`` returned."""
    return "\n".join(
        [
            f"<h2>Linear baselines of {_escaped(result['output'])}</h2>",
            _summary(result),
            _fits(result),
            "<h3>Impulse responses and dead times</h3>",
            _impulse(result),
            "<h3>ARX orders</h3>",
            _arx(result),
            "<h3>State space and output error</h3>",
            _states(result),
            "<h3>What the models leave over</h3>",
            _residuals(result),
        ]
    )


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _number(value: float | None, form: str = ".1f") -> str:
    return "–" if value is None else f"{value:{form}}"


def _output_label(result: Result) -> str:
    return f"{result['output']} [{result['unit']}]" if result["unit"] else str(result["output"])


def _summary(result: Result) -> str:
    samples, skip = result["samples"], result["skip"]
    best = result["models"][result["best"]]
    arx = result["models"]["arx_free_run"]
    short = [
        f"{total - kept} of {total} {role} stretches, shorter than {2 * skip} samples, are left out"
        for role, (kept, total) in result["stretches"].items()
        if kept < total
    ]
    return paragraph(
        f"Inputs {', '.join(result['inputs'])}; one sample is {result['period_s']:g} s. Trained on "
        f"{samples['training']} samples, orders chosen on {samples['validation']}, judged on "
        f"{samples['test']} others. Every model runs on its own output after the first {skip} "
        "samples of each stretch, which set its initial conditions and are not scored. "
        + "".join(f"{s}. " for s in short)
        + f"Chosen on the validation samples: {TITLES[result['best']]}, "
        f"{_number(best['fit_percent'])} % fit on the test samples in free run; the best ARX "
        f"reaches {_number(arx['fit_percent'])} %."
    )


def _range(low: float | None, high: float | None, unit: str) -> str:
    unit = f" {unit}" if unit else ""
    if low is None:
        return "all" if high is None else f"below {high:.4g}{unit}"
    return f"from {low:.4g}{unit}" if high is None else f"{low:.4g} to {high:.4g}{unit}"


def _fits(result: Result) -> str:
    models, regime = result["models"], result["regime"]
    ranges = (
        []
        if regime is None
        else [_range(low, high, regime["unit"]) for low, high in regime["ranges"]]
    )
    head = ("model", "parameters", "validation", "test", "one step, test", "correlation", *ranges)
    rows = [
        (
            TITLES[name],
            str(m["parameters"]),
            _number(m["validation_fit_percent"]),
            _number(m["fit_percent"]) if m["stable"] else "unstable",
            _number(m["one_step_fit_percent"]),
            _number(m["correlation"], ".3f"),
            *(_number(f) for f in m["regime_fit_percent"]),
        )
        for name, m in models.items()
    ]
    each = [
        (f"test stretch {i}", *(_number(m["stretch_fit_percent"][i]) for m in models.values()))
        for i in range(len(models["subspace"]["stretch_fit_percent"]))
    ]
    note = "Fit in percent, 100 (1 - |y - y_hat| / |y - mean y|), in free run where nothing else "
    note += "is said; below 0 the mean would be better. A one-step fit near 100 says little: the "
    note += "last sample alone predicts the next well."
    if regime is not None:
        note += f" Columns on the right: ranges of {regime['name']}, each against its own mean."
    parts = [paragraph(note, "note"), table(rows, head, list(models).index(result["best"]))]
    parts.append(picture(_fit_chart(result, ranges), "Free-run fit on the test samples"))
    parts.append(picture(_example(result), "A part of the test samples with the free runs"))
    if 1 < len(each) <= 30:
        parts.append(table(each, ("fit in %", *(TITLES[n] for n in models))))
    return "".join(parts)


def _fit_chart(result: Result, ranges: Sequence[str]) -> Figure:
    models = result["models"]
    groups = ["all samples", *ranges]
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axes = figure.add_subplot()
    width = 0.8 / len(models)
    for i, (name, m) in enumerate(models.items()):
        values = [m["fit_percent"], *m["regime_fit_percent"]]
        heights = [max(v, -20.0) if v is not None else 0.0 for v in values]
        shift = (i - (len(models) - 1) / 2) * width
        axes.bar(np.arange(len(groups)) + shift, heights, 0.9 * width, label=TITLES[name])
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.set_xticks(range(len(groups)), groups)
    axes.set_ylabel("fit, %")
    if ranges:
        axes.set_xlabel(result["regime"]["name"])
    axes.legend(fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.22), frameon=False)
    return figure


def _example(result: Result) -> Figure:
    shown = result["example"]
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(shown["time_s"], shown["measured"], color="0.2", linewidth=1.1, label="measured")
    for name, run in shown["runs"].items():
        axes.plot(shown["time_s"], run, color=COLOURS[name], linewidth=0.9, label=TITLES[name])
    axes.set(xlabel=f"s of test stretch {shown['stretch']}", ylabel=_output_label(result))
    axes.legend(fontsize=8, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.14), frameon=False)
    return figure


def _impulse(result: Result) -> str:
    period_s, found = result["period_s"], result["impulse"]

    def delay(samples: int | None) -> str:
        return "no response" if samples is None else f"{samples} ({samples * period_s:.4g} s)"

    rows = [
        (
            row["input"],
            delay(row["delay"]),
            delay(row["arx_delay"])
            + (", the largest tried" if row["arx_delay"] == found["largest_arx_delay"] else ""),
        )
        for row in found["rows"]
    ]
    head = ("input", "dead time from the impulse response, samples", "from ARX of order 2")
    words = (
        "Bands hold 99 % at each lag; the disturbance's AR(10) is filtered out first, so that "
        "neighbouring samples do not count as independent ones. The dead time is the first lag "
        "outside the band that all lags hold together (99 %) with at least a tenth of the peak. "
        f"Beside it: the best ARX of order 2 over dead times 0 to {found['largest_arx_delay']}. "
    )
    left = found["largest_autocorrelation_left"]
    if left > 0.1:
        words += (
            f"After the filter an autocorrelation of up to {left:.2f} is left: the response is "
            "longer than the lags shown or not linear, so read the bands as the least there is."
        )
    figure = picture(
        _impulse_figure(result), "Impulse responses, 99 % bands shaded, dead time dashed"
    )
    return paragraph(words, "note") + table(rows, head) + figure


def _impulse_figure(result: Result) -> Figure:
    rows = result["impulse"]["rows"]
    columns = min(3, len(rows))
    lines = -(-len(rows) // columns)
    figure = Figure(figsize=(9, 2.1 * lines), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, row in zip(grid, rows, strict=False):
        t_s = np.arange(len(row["response"])) * result["period_s"]
        band = np.array(row["band"], dtype=float)
        axes.fill_between(t_s, -band, band, color="0.85", step="mid")
        axes.plot(t_s, row["response"], marker=".", markersize=3, linewidth=0.8)
        if row["delay"] is not None:
            axes.axvline(
                row["delay"] * result["period_s"], color="C3", linestyle="--", linewidth=0.8
            )
        axes.set_title(row["input"], fontsize=9)
        axes.tick_params(labelsize=8)
    for axes in grid[len(rows) :]:
        axes.set_axis_off()
    figure.supxlabel("s after a pulse of one sample", fontsize=9)
    figure.supylabel(f"{result['output']} per unit of input", fontsize=9)
    return figure


def _delays(delays: Sequence[int]) -> str:
    return str(delays[0]) if len(set(delays)) == 1 else " ".join(map(str, delays))


def _arx(result: Result) -> str:
    found = result["arx"]
    rows = [
        (TITLES[name], str(c["na"]), str(c["nb"]), _delays(c["nk"]),
         str(result["models"][name]["parameters"]))
        for name, c in found["choices"].items()
    ]  # fmt: skip
    edge = [
        TITLES[n]
        for n, c in found["choices"].items()
        if max(c["na"], c["nb"]) >= result["largest_order"]
    ]
    words = (
        f"{found['candidates']} models: na and nb from 1 to {result['largest_order']}, dead times "
        "the same for all inputs or those of the table above. Sum of squares is that of one-step "
        "predictions on the validation samples; AIC = log V + 2 d/N, MDL = V (1 + d log N / N) "
        "with the training loss V. The last row is chosen for its free run on the validation "
        "samples (na = 0 allowed); it is the reference beside every NARX."
    )
    if edge:
        words += f" At the largest order tried: {', '.join(edge)}; more would fit one step closer."
    figure = picture(
        _criteria(result), "Criteria over the number of parameters, best of each number"
    )
    return (
        paragraph(words, "note") + table(rows, ("choice", "na", "nb", "nk", "parameters")) + figure
    )


def _criteria(result: Result) -> Figure:
    found = result["arx"]
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    panels = figure.subplots(1, 3)
    titles = ("sum of squares, validation", "MDL", "AIC")
    for axes, key, title in zip(panels, ("validation_loss", "mdl", "aic"), titles, strict=True):
        values = np.array(found[key], dtype=float)
        axes.plot(found["parameters"], values, linewidth=1.0)
        best = int(np.nanargmin(values))
        axes.plot(found["parameters"][best], values[best], "o", color="C3", markersize=4)
        if key != "aic":
            axes.set_yscale("log")
        axes.set(title=title, xlabel="parameters")
        axes.tick_params(labelsize=8, which="both")
        axes.title.set_fontsize(9)
    return figure


def _states(result: Result) -> str:
    found, error = result["subspace"], result["output_error"]
    words = (
        f"Subspace method (PBSID) from {found['past']} past samples: order {found['order']} runs "
        f"freely best on the validation samples; the singular values fall most after "
        f"{found['order_by_gap']}. Output error: denominator of order {error['nf']} common to all "
        f"inputs, {error['nb']} coefficients per input from dead time {_delays(error['nk'])} on, "
        f"the best of {len(error['starts'])} starts on the validation samples."
    )
    starts = sorted(error["starts"], key=lambda s: _last(s["validation_rmse"]))
    rows = [
        (s["start"], str(s["nf"]), str(s["nb"]), _delays(s["nk"]),
         _number(s["training_rmse"], ".4g"), _number(s["validation_rmse"], ".4g"))
        for s in starts[:8]
    ]  # fmt: skip
    head = ("output error started from", "nf", "nb", "nk", "RMSE, training", "RMSE, validation")
    figure = picture(_singular(result), "Singular values; free-run error over the number of states")
    return paragraph(words) + figure + table(rows, head, 0)


def _last(value: float | None) -> float:
    return float("inf") if value is None else value


def _singular(result: Result) -> Figure:
    found = result["subspace"]
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    values = found["singular_values"][:20]
    orders = np.arange(1, len(values) + 1)
    left.bar(orders, values, color=["C0" if o <= found["order"] else "0.8" for o in orders])
    left.set(yscale="log", xlabel="state", ylabel="singular value")
    left.set_xticks(orders[1::2])
    right.set_xticks(range(1, len(found["validation_rmse"]) + 1))
    errors = np.array([np.nan if e is None else e for e in found["validation_rmse"]])
    right.plot(np.arange(1, len(errors) + 1), errors, marker=".")
    right.plot(found["order"], errors[found["order"] - 1], "o", color="C3", markersize=5)
    right.set(xlabel="states", ylabel="RMSE, validation, free run")
    low = float(np.nanmin(errors))
    right.set_ylim(0.9 * low, min(2.5 * low, 1.05 * float(np.nanmax(errors))))
    return figure


def _residuals(result: Result) -> str:
    found = result["residuals"]
    rows = []
    for name, tests in found.items():
        white = tests["whiteness"]
        dependent = [t["input"] for t in tests["independence"] if t["rejected"]]
        feedback = [t["input"] for t in tests["independence"] if t["feedback"]]
        rows.append(
            (
                TITLES[name],
                "rejected" if white["rejected"] else "not rejected",
                f"{white['p_value']:.2g}",
                f"{white['outside']} of {white['lags']}",
                f"rejected for {', '.join(dependent)}" if dependent else "not rejected",
                ", ".join(feedback) or "none",
            )
        )
    head = (
        "model",
        "residuals are white",
        "p (Ljung-Box)",
        "lags outside 99 %",
        "residuals do not depend on the inputs",
        "inputs that follow the residuals",
    )
    words = (
        "On the test samples, at the level of 1 %: one-step residuals of ARX and state space, "
        "simulation residuals of output error, which models no disturbance and need not be white. "
        "Whiteness rejected: the past still tells something of the residual. Independence "
        "rejected: an input acts in a way the model lacks, in its dynamics, its dead time or its "
        "curvature. An input that follows the residuals is made from the output: a loop is closed. "
        "On many samples the tests see what no use of the model would notice; the size of the "
        "correlations in the figure says how much it is."
    )
    figure = picture(_correlations(result), "Residual correlations with their 99 % bands")
    return table(rows, head) + paragraph(words, "note") + figure


def _correlations(result: Result) -> Figure:
    tests = result["residuals"]["arx_free_run"]
    white, inputs = tests["whiteness"], tests["independence"]
    columns = min(3, len(inputs) + 1)
    lines = -(-(len(inputs) + 1) // columns)
    figure = Figure(figsize=(9, 2.1 * lines), layout="constrained")
    first, *others = figure.subplots(lines, columns, squeeze=False).ravel()
    first.axhspan(-white["band"], white["band"], color="0.85")
    first.vlines(range(1, white["lags"] + 1), 0.0, white["autocorrelation"][1:], linewidth=1.2)
    first.set_title("autocorrelation", fontsize=9)
    for axes, test in zip(others, inputs, strict=False):
        axes.axhspan(-test["band"], test["band"], color="0.85")
        axes.vlines(test["lags"], 0.0, test["correlation"], linewidth=1.0)
        axes.set_title(f"with {test['input']}", fontsize=9)
    for axes in (first, *others[: len(inputs)]):
        axes.axhline(0.0, color="0.4", linewidth=0.6)
        axes.tick_params(labelsize=8)
    for axes in others[len(inputs) :]:
        axes.set_axis_off()
    figure.supxlabel("lag in samples; ARX chosen for its free run", fontsize=9)
    return figure
