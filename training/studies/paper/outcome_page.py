"""What the study found, as HTML: the choice, closed loop, residuals, steady training."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from training.pages.page import paragraph, picture, table
from training.studies.paper.figures import (
    label,
    residual_figure,
    sensor_figure,
    steady_figure,
    window_figure,
)
from training.studies.paper.outcome.comparison import beside_table


def small(table_html: str) -> str:
    """Return a wide table in smaller type."""
    return f'<div style="font-size:85%">{table_html}</div>'


def text_table(rows: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    """Return a table of words, all cells set to the left."""
    lines = ["".join(f"<th>{escape(h)}</th>" for h in head)]
    lines += ["".join(f"<td>{escape(c)}</td>" for c in row) for row in rows]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def figures(m: Mapping[str, Any]) -> tuple[str, ...]:
    """Return samples, R, fit and RMSE as cells."""
    return (
        f"{m['samples']:.0f}",
        number(m.get("correlation"), ".3f"),
        number(m.get("fit_percent"), ".1f"),
        number(m.get("rmse"), ".4g"),
    )


def number(value: float | None, form: str) -> str:
    """Return a number as text, a dash for None."""
    return "–" if value is None else f"{value:{form}}"


def free(part: Mapping[str, Any]) -> str:
    """Return the section: the structures that were tried."""
    rows = [
        (
            f"inputs to lag {t['longest']}, outputs to lag {t['lags']}, "
            f"layers {'-'.join(map(str, t['hidden'])) or 'none'}",
            str(t["n_weights"]),
            f"{t['rmse']:.4f}",
        )
        for t in part["tries"][:12]
    ]
    text = (
        "The 29 models share the paper's grid of lags and layers. Beside them, memory and size "
        "were chosen by the data as o2train fit does: a walk over structures with boxed input "
        f"lags and a linear path, each trained shortly and judged in free run; {len(part['tries'])}"
        f" were tried. It ended at {part['structure']} ({part['n_weights']} weights), chosen from "
        f"{_starts(part)}."
    )
    return (
        "<h2>Memory and size chosen by the data</h2>"
        + paragraph(text)
        + table(rows, ("the best that were tried", "weights", "free-run RMSE, short training"), 0)
    )


def choice(parts: Mapping[str, Any]) -> str:
    """Return the section: the candidates and the limits."""
    result, shipped = parts["choice"], parts["shipped"]
    rows = [
        (
            c["name"] if c["number"] is None else f"{c['number']}  {c['name']}",
            str(c["n_weights"]),
            f"{c['validation_rmse']:.4f}",
            "yes" if i in result["equal"] else "no",
            "yes" if c["forgets"] else "no",
            number(c["after"]["enabled"].get("correlation"), ".3f"),
            number(c["after"]["enabled"].get("rmse"), ".4g"),
            number(c["after"]["all"].get("fit_percent"), ".1f"),
        )
        for i, c in enumerate(result["candidates"])
    ]
    head = (
        "candidate",
        "weights",
        "validation RMSE",
        "equal to the best",
        "forgets",
        "test R",
        "test RMSE",
        "fit, all samples, %",
    )
    limits = [
        (k, f"{v['value']:.4g} {v['unit']}".strip(" -"), v["origin"])
        for k, v in shipped["limits"].items()
    ]
    out = [
        "<h2>The choice</h2>",
        paragraph(result["reason"]),
        small(table(rows, head, result["chosen"])),
        paragraph(
            "Validation RMSE: free run on the validation blocks, scaled units, weighted as in the "
            "training; it alone decides. Equal: within one standard error over the blocks or 1 % "
            f"of the best. Test figures are of {result['test']} and chose nothing; R and RMSE "
            "where the monitor judges. The 29 models see at most the training samples set for the "
            "study, the free structure all of them.",
            "note",
        ),
    ]
    if limits:
        out += [
            "<h3>Decision limits in the model card</h3>",
            small(text_table(limits, ("limit", "value", "from"))),
        ]
    return "\n".join(out)


def closed_loop(result: Mapping[str, Any]) -> str:
    """Return the section: what closed-loop training gained."""
    rows = []
    for c in result["candidates"]:
        if "before" not in c:
            continue
        before, after = (c[k]["enabled"] for k in ("before", "after"))
        gain = None
        if before.get("rmse") and after.get("rmse") is not None:
            gain = 100 * (1 - after["rmse"] / before["rmse"])
        rows.append(
            (
                c["name"],
                number(before.get("rmse"), ".4g"),
                number(after.get("rmse"), ".4g"),
                number(gain and round(gain) + 0.0, ".0f"),
                number(before.get("correlation"), ".3f"),
                number(after.get("correlation"), ".3f"),
                c["stage"],
                f"{c['gap']:.2g} ({c['gap_limit']:.2g})",
            )
        )
    head = (
        "model",
        "RMSE one-step only",
        "after closed loop",
        "less by, %",
        "R one-step only",
        "after",
        "best stage",
        "two histories apart (limit)",
    )
    text = (
        f"The same start of each model on {result['test']} in free run, before and after training "
        "on the simulation error with exact gradients, horizons growing from 5 to 1,000 samples. "
        "The stage with the lowest free-run validation error is kept. Two histories: the largest "
        "difference of two predictions from random histories after 50 samples."
    )
    chosen = result["chosen"] if len(rows) == len(result["candidates"]) else None
    return (
        "<h2>What closed-loop training gains</h2>"
        + paragraph(text)
        + small(table(rows, head, chosen))
    )


def beside(parts: Mapping[str, Any]) -> str:
    """Return the section: the fits beside those of linear models."""
    if "skipped" in parts["beside"]:
        return ""
    result = parts["choice"]
    name = result["candidates"][result["chosen"]]["name"]
    return "<h2>Beside linear models</h2>" + small(beside_table(parts["beside"], name))


def against_sensor(sensor: Mapping[str, Any]) -> str:
    """Return the section: model against sensor."""
    bounded = sensor["bounded"]
    text = (
        "Model against sensor as in figure 6 of the paper. Left a lively part of the samples, "
        "grey where nothing is judged; right the prediction over the measurement where it is."
    )
    stable = (
        f"From {bounded['runs']} random histories over {bounded['samples']} samples, "
        f"{bounded['stuck']} free runs stayed at an end of the output's range. Feedback is "
        "clipped to that range, so no run can leave it."
    )
    return (
        "<h2>Model against sensor</h2>"
        + paragraph(text)
        + picture(sensor_figure(sensor["views"], sensor), f"Free run, {label(sensor)}")
        + paragraph(stable)
    )


def faulty(sensor: Mapping[str, Any]) -> str:
    """Return the section: residuals, healthy and faulty."""
    rows = [
        (
            "healthy",
            f"{sensor['healthy_on']}, {sensor['healthy_source']}",
            *_residual_cells(sensor["healthy"]),
        )
    ]
    rows += [(f["name"].replace("_", " "), f["how"], *_residual_cells(f)) for f in sensor["faults"]]
    head = (
        "",
        "how",
        "samples",
        "mean",
        "std",
        "windows",
        "|mean| ≥ Jμ, %",
        "std ≥ Jσ, %",
        "both, %",
    )
    j = sensor["limits"]
    limit = f"Jμ = {j['j_mu']:.3g} and Jσ = {j['j_sigma']:.3g}" if "j_mu" in j else "no limits"
    afterwards = any(f["how"] == "put on afterwards" for f in sensor["faults"])
    text = (
        "Residuals as in figure 7 of the paper: measured minus predicted, where the monitor "
        f"judges, over windows of 50 samples. The paper's rule wants both limits exceeded "
        f"({limit}, dotted). {_rule(sensor)}"
    )
    note = (
        "The faults were put on the recorded output afterwards: the control loop did not answer "
        "to them. Recordings with the fault in the loop can be given with --faulty."
    )
    parts = [
        "<h2>Healthy and faulty</h2>",
        paragraph(text),
        paragraph(note, "note") * afterwards,
        _unreadable(sensor),
        small(table(rows, head)),
    ]
    if sensor["faults"]:
        shown = [f["view"] for f in sensor["faults"]][:6]
        parts += [
            picture(
                residual_figure(sensor),
                "Residuals, healthy (grey) and faulty; dotted: ± Jμ; "
                "what lies beyond is in the last bins",
            ),
            picture(
                window_figure(sensor),
                "Windows of 50 residuals; dotted: the limits Jμ, Jσ; the farthest are cut off",
            ),
            picture(sensor_figure(shown, sensor), "Model against the faulty sensor"),
        ]
    return "".join(parts)


def _starts(part: Mapping[str, Any]) -> str:
    n = len(part["starts"])
    return "one training" if n == 1 else f"{n} trainings, several starts of the best structures"


def _unreadable(sensor: Mapping[str, Any]) -> str:
    names = ", ".join(sensor["unreadable"])
    return paragraph(f"Nothing to compare in {names}: no valid output.", "note") if names else ""


def _rule(sensor: Mapping[str, Any]) -> str:
    """Return how often the paper's rule fires, in words."""
    if "j_mu" not in sensor["limits"] or not sensor["faults"]:
        return ""
    healthy = 100 * sensor["healthy"]["beyond"]["both"]
    shares = sorted(100 * f["beyond"]["both"] for f in sensor["faults"])
    form = ".0f" if shares[-1] >= 10 else ".1f"
    return (
        f"It fires in {healthy:.1f} % of the healthy windows and in {shares[0]:{form}} to "
        f"{shares[-1]:{form}} % of the windows under a fault. It cannot say which fault; the "
        "monitor's response rule can."
    )


def _residual_cells(r: Mapping[str, Any]) -> tuple[str, ...]:
    beyond = [f"{100 * r['beyond'][k]:.1f}" for k in ("mean", "std", "both")]
    return (
        str(r["samples"]),
        number(r["mean"], ".4f"),
        number(r["std"], ".4f"),
        str(r["windows"]),
        *beyond,
    )


def steady(result: Mapping[str, Any]) -> str:
    """Return the section: steady against mixed training."""
    rows = []
    for name, m in result["models"].items():
        on = m["enabled"] if "rmse" in m["enabled"] else m["all"]
        rows.append(
            (
                f"{name} training",
                str(m["samples"]),
                number(m["own_validation_rmse"], ".4g"),
                *figures(on)[1:],
                number(m["all"].get("fit_percent"), ".1f"),
                f"{100 * m['outside']:.1f} %",
            )
        )
    head = (
        "the paper's structure",
        "training samples",
        "own validation RMSE",
        "R",
        "fit, %",
        "RMSE",
        "fit, all samples, %",
        "outside its range",
    )
    errors = [result["models"][k]["enabled"].get("rmse") for k in ("steady", "mixed")]
    text = (
        "The paper trains at steady operating points and predicts drive cycles. Here its structure "
        f"(5 lags, layers 8-8) is trained twice by the same recipe on equally many samples: on "
        f"steady driving ({result['rule']}) and on the whole campaign. Both run freely on "
        f"transient driving: {result['test']} ({result['test_source']})."
    )
    verdict = ""
    if None not in errors and errors[1]:
        ratio = errors[0] / errors[1]
        verdict = (
            f"On transient driving the steady training has {ratio:.2f} times the error of the "
            "mixed one where the monitor judges."
        )
    if any(m["cut"] for m in result["models"].values()):
        verdict += " The budget ended a training early (--budget): the figures are not final."
    note = (
        "Outside its range: share of test samples with an input that the training never reached; "
        "inputs are clipped there."
    )
    return (
        "<h2>Steady training, transient use</h2>"
        + paragraph(text)
        + small(table(rows, head))
        + paragraph(verdict)
        + paragraph(note, "note")
        + picture(steady_figure(result), f"Free run on transient driving, {label(result)}")
    )
