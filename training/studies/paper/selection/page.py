"""Part 2 of the study as HTML: principal components, the choice, free runs, transparency."""

from html import escape
from typing import Any

from matplotlib.figure import Figure

from training.pages.page import paragraph, picture, table
from training.studies.paper.selection.pca import biplot_figure, control_figure, scree_figure

LARGE_INFLATION = 10.0  # the other variables explain 90 % of it
VERDICTS = {
    "better": "better than the chosen set, in every start and beyond the interval",
    "worse": "worse than the chosen set, in every start and beyond the interval",
    "as good": "as good as the chosen set, within 10 %",
    "not told apart": "not told apart from the chosen set by these test blocks and starts",
}


def section(result: dict[str, Any]) -> str:
    """Return the part's HTML from what ``selection`` gave."""
    n, simulated = result["recordings"], result["simulated"]
    text = f"{len(result['candidates'])} candidates in {n} recordings"
    text += f", {simulated} of them simulated." if simulated else "."
    return "\n".join(
        [
            "<h2>Input selection</h2>",
            paragraph(text),
            "<h3>Principal components</h3>",
            *_components(result["pca"]),
            "<h3>The choice</h3>",
            *_choice(result),
            "<h3>Check by free run</h3>",
            *_sets(result),
            "<h3>Transparency</h3>",
            *_transparency(result),
        ]
    )


def _components(pca: dict[str, Any]) -> list[str]:
    kept, share = pca["kept"], 100 * pca["explained"][pca["kept"] - 1]
    text = (
        f"{pca['samples']} samples, z-scored. {kept} components explain {share:.0f} % of the "
        "variance of the candidates."
    )
    beyond = (
        f"Q measures what the kept components do not explain: a sample whose signals do not fit "
        f"together as they usually do. T² measures how far out a sample is within them. "
        f"{100 * pca['q_beyond']:.1f} % of the samples lie beyond the limit of Q and "
        f"{100 * pca['t_squared_beyond']:.1f} % beyond that of T²; normal and independent samples "
        f"would do so in {100 * pca['alpha']:g} %. Driving is neither, so the limits mark places "
        "to look at, not faults."
    )
    parts = [paragraph(text), picture(scree_figure(pca), "Scree and loadings")]
    if len(pca["scores"]) > 1:
        parts.append(
            picture(
                biplot_figure(pca),
                "Biplot: loadings (arrows) and scores (grey, 99 % of them within 1)",
            )
        )
    if len(pca["variances"]) > 1:
        parts.append(paragraph(beyond))
        parts.append(picture(control_figure(pca), "Q residuals and Hotelling's T² over time"))
    return parts


def _choice(result: dict[str, Any]) -> list[str]:
    rows = []
    for v in result["variables"]:
        among = "-" if v["inflation_chosen"] is None else f"{v['inflation_chosen']:.3g}"
        cells = [
            f"{v['correlation']:.2f} at {v['lag']}",
            f"{v['inflation']:.3g}",
            among,
            f"{v['loading']:.2f} on {v['component']}",
            "yes" if v["chosen"] else "no",
        ]
        numbers = "".join(f'<td class="n">{escape(c)}</td>' for c in cells)
        mark = ' class="chosen"' if v["chosen"] else ""
        words = _reason(v)
        rows.append(f"<tr{mark}><td>{escape(v['name'])}</td>{numbers}</tr>")
        rows.append(f'<tr><td class="note" colspan="6">{escape(words)}</td></tr>')
    head = (
        "variable",
        "correlation at lag",
        "inflation, all",
        "inflation, chosen",
        "largest loading",
        "chosen",
    )
    cells_head = "".join(f"<th>{h}</th>" for h in head)
    note = (
        "Correlation: with the output, the input so many samples before, where it is largest. "
        "Variance inflation: 1/(1 − R²) of the variable on the others, 10 is 90 % explained."
    )
    return [f"<table><tr>{cells_head}</tr>{''.join(rows)}</table>", paragraph(note, "note")]


def _reason(variable: dict[str, Any]) -> str:
    """Return why a variable is in or out, from its physics and from its numbers."""
    redundant = variable["inflation"] > LARGE_INFLATION
    share = 100 * (1.0 - 1.0 / variable["inflation"])
    numbers = (
        f"the others explain {share:.1f} % of it"
        if redundant
        else f"{100 - share:.0f} % of it is its own"
    )
    physical = f"{variable['reason']}; " if variable["reason"] else ""
    numbers += f", correlation with the output {variable['correlation']:.2f}"
    if variable["chosen"]:
        inside = variable["inflation_chosen"]
        kept = inside is not None and inside > LARGE_INFLATION
        note = ", redundant even among the chosen, kept for its physics" if kept else ""
        return f"In: {physical}{numbers}{note}."
    return f"Out: {physical}{numbers}."


def _sets(result: dict[str, Any]) -> list[str]:
    phi = result["transform"] == "phi"
    unit = "phi" if phi else result["output"]
    first = result["sets"][0]
    text = (
        "The same small NARX (5 lags, 8 neurons, two starts, trained series-parallel and then in "
        "closed loop up to 100 samples) on each set of inputs, on the same blocks; "
        f"{first['samples']} test samples that no training step saw"
        f"{', in closed loop outside fuel cut' if phi else ''}. Figures are of the free run."
    )
    verdicts = {c["name"]: c for c in result["comparisons"]}
    rows = []
    for s in result["sets"]:
        found = verdicts.get(s["name"])
        change = "-"
        if found:
            percent = [100 * found[k] / found["rmse"] for k in ("difference", "low", "high")]
            change = f"{percent[0]:+.0f} ({percent[1]:+.0f} to {percent[2]:+.0f})"
        starts = ", ".join(f"{v:.4g}" for v in s["rmse_of_starts"])
        fit = "-" if s["fit_percent"] is None else f"{s['fit_percent']:.1f}"
        rows.append(
            (
                f"{s['name']} ({len(s['inputs'])})",
                f"{s['rmse']:.4g}",
                starts,
                f"{s['correlation']:.3f}",
                fit,
                change,
            )
        )
    head = (
        "set (inputs)",
        f"RMSE, {unit}",
        "of each start",
        "correlation",
        "fit, %",
        "RMSE against chosen, % (95 %)",
    )
    parts = [paragraph(text), table(rows, head, chosen=0)]
    parts += [paragraph(_verdict(c)) for c in result["comparisons"]]
    short = sum(s["stopped_by_budget"] for s in result["sets"])
    if short:
        parts.append(paragraph(f"The budget ended {short} trainings early.", "warning"))
    note = (
        "The interval is from drawing blocks of 100 test samples; it says nothing about another "
        "start of the training, whose spread stands in the table."
    )
    parts.append(paragraph(note, "note"))
    return parts


def _verdict(found: dict[str, Any]) -> str:
    name = found["name"][0].upper() + found["name"][1:]
    return f"{name}: {VERDICTS[found['verdict']]}."


def _transparency(result: dict[str, Any]) -> list[str]:
    own = result["transparency"]
    if own is None:
        text = (
            "lambda_controller is not among the inputs, so nothing in them is made from the "
            "measured output by a controller, and no sensor fault reaches the prediction that way."
        )
        return [paragraph(text)]
    if own["controller"] is None:
        text = (
            "The controller's law cannot be estimated: too little closed loop, or what is found "
            "does not close a stable loop."
        )
        return [paragraph(text, "warning")]
    text = (
        "lambda_controller is made from the measured lambda: a network that sees it can invert the "
        "controller and predict what a faulty sensor reads. What the controller makes of a faulty "
        "reading (its law is estimated from the recordings, correlation with its increments "
        f"{own['controller']['explained']:.2f}, dead time of the loop "
        f"{own['controller']['dead_time']} samples) is put on this one input; all other inputs "
        "stay, as they would with the true mixture unchanged. Gain 0 is a prediction that knows "
        "nothing of the fault, 1 one that follows it."
    )
    rows = [
        (
            f"{r['fault']} {r['severity']:g}",
            r["set"],
            f"{r['gain']:.2f}",
            f"{100 * r['share']:.0f}",
            f"{100 * r['seen']:.0f}",
        )
        for r in own["reach"]
    ]
    head = (
        "fault put on the reading",
        "set",
        "gain",
        "reaches the prediction, % RMS",
        "left in the residual, % RMS",
    )
    return [
        paragraph(text),
        table(rows, head),
        picture(_figure(own["reach"]), "Share of the fault that reaches the prediction"),
        paragraph(_balance(result)),
    ]


def _balance(result: dict[str, Any]) -> str:
    """Return in words what leaving the controller out costs and gains."""
    rmse = {s["name"]: s["rmse"] for s in result["sets"]}
    reach = result["transparency"]["reach"]
    worst = {
        name: max((abs(r["gain"]) for r in reach if r["set"] == name), default=0.0)
        for name in ("chosen", "controller exact")
    }
    cost = ""
    if "without the controller" in rmse:
        change = {n: 100 * (rmse["without the controller"] / rmse[n] - 1) for n in worst}
        cost = (
            f"Leaving lambda_controller out changes the free-run RMSE on healthy test samples by "
            f"{change['chosen']:+.0f} % against the chosen set, whose controller is blurred by "
            f"noise of 0.03 in training, and by {change['controller exact']:+.0f} % against a "
            "network that sees it exactly. "
        )
    return (
        f"{cost}It gains a prediction that no fault reaches through the controller. A network that "
        f"sees it exactly follows up to {100 * worst['controller exact']:.0f} % of a fault, the "
        f"blurred one up to {100 * worst['chosen']:.0f} %."
    )


def _figure(reach: list[dict[str, Any]]) -> Figure:
    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    faults = list(dict.fromkeys(r["fault"] for r in reach))
    sets = list(dict.fromkeys(r["set"] for r in reach))
    for number, name in enumerate(sets):
        own = [100 * r["share"] for r in reach if r["set"] == name]
        at = [i + (number - 0.5 * (len(sets) - 1)) * 0.25 for i in range(len(faults))]
        axes.bar(at, own, 0.22, label=name)
    axes.set_xticks(range(len(faults)), faults)
    axes.set_ylabel("RMS reaching the\nprediction, %")
    figure.legend(loc="outside upper right", ncols=len(sets), frameon=False)
    return figure
