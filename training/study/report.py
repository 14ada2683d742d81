"""The study as one self-contained page: summary first, then every part."""

import re
from collections.abc import Mapping
from html import escape
from typing import Any

from training import check_page
from training.page import page, paragraph, picture, table
from training.study import (
    linear,
    narx_section,
    paper,
    preparation_page,
    selection_page,
)
from training.study.baselines import beside_table
from training.study.figures import (
    label,
    residual_figure,
    sensor_figure,
    steady_figure,
    window_figure,
)

_HEADING = re.compile(r"<h2>(.*?)</h2>", re.DOTALL)
_SECTIONS = {
    "check": lambda part: "<h2>Is the data enough?</h2>" + check_page.body(part),
    "preparation": preparation_page.section,
    "selection": selection_page.section,
    "linear": linear.section,
    "narx": narx_section.section,
}
_SKIPPED = {
    "preparation": "Preparation", "selection": "Input selection", "linear": "Linear baselines",
    "narx": "NARX study", "steady": "Steady training, transient use",
}  # fmt: skip


def report(parts: Mapping[str, Any], warnings: list[str]) -> str:
    """Return the page from the parts' results, as they stand in study.json."""
    sections = []
    for name in ("check", "preparation", "selection", "linear", "narx"):
        part = parts[name]
        sections.append(_skipped(name, part) if "skipped" in part else _SECTIONS[name](part))
    sections += [_free(parts["free"]), _choice(parts), _closed_loop(parts["choice"])]
    sections += [_beside(parts), _sensor(parts["sensor"]), _faulty(parts["sensor"])]
    steady = parts["steady"]
    sections.append(_skipped("steady", steady) if "skipped" in steady else _steady(steady))
    body = "\n".join([_summary(parts, warnings), *sections])
    titles: list[str] = []

    def anchored(found: re.Match[str]) -> str:
        titles.append(found[1])
        return f'<h2 id="part{len(titles)}">{found[1]}</h2>'

    body = _HEADING.sub(anchored, body)
    links = "".join(f'<li><a href="#part{i}">{t}</a></li>' for i, t in enumerate(titles, 1))
    return page(_title(parts), f"<nav><ol>{links}</ol></nav>\n{body}")


def _title(parts: Mapping[str, Any]) -> str:
    return f"Study of {parts['choice']['output']}"


def _skipped(name: str, part: Mapping[str, Any]) -> str:
    return f"<h2>{_SKIPPED[name]}</h2>" + paragraph(f"Left out: {part['skipped']}.", "warning")


def _summary(parts: Mapping[str, Any], warnings: list[str]) -> str:
    choice, sensor, data = parts["choice"], parts["sensor"], parts["data"]
    drives = [(d["use"], d["path"], d["source"], str(d["samples"]), d["sha256"][:12])
              for d in data["recordings"]]  # fmt: skip
    out = [
        "<h2>Summary</h2>",
        *(paragraph(w, "warning") for w in warnings),
        paragraph(_what(data)),
        paragraph(choice["reason"]),
        table(_views(sensor), ("free run of the chosen model", "source", "samples", "R",
                               "fit, %", f"RMSE{_unit(sensor)}")),
        paragraph("Where the monitor judges (closed loop, no fuel cut, sensor ready), as far as "
                  "the recordings say; the last rows are drives that no step of the study saw."
                  if sensor["healthy_on"] == "held-out drives" else
                  "Where the monitor judges, as far as the recordings say. No held-out drives "
                  "were given (--test), so test blocks of the same drives judge.", "note"),
        paragraph(f"The paper chose {paper.LAGS} lags and two layers of eight with "
                  f"Levenberg–Marquardt at rate {paper.RATE}: MSE {paper.MSE}, R "
                  + ", ".join(f"{r:.3f} {k}" for k, r in paper.R.items()) + "."),
        "<h3>The paper's numbers beside ours</h3>",
        _paper(parts),
        "<h3>Recordings</h3>",
        table(drives, ("use", "recording", "source", "samples", "sha256")),
    ]  # fmt: skip
    return "\n".join(out)


def _what(data: Mapping[str, Any]) -> str:
    return (
        f"{data['output']} from {', '.join(data['inputs'])}, every {data['period_s']:g} s; "
        f"{data['samples']} samples of {data['source']} recordings to train and choose on. "
        f"The chosen model is in model.onnx, every number of this page in study.json."
    )


def _unit(sensor: Mapping[str, Any]) -> str:
    return f", {sensor['unit']}" if sensor["unit"] not in ("", "-") else ""


def _views(sensor: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [(v["title"], v["source"], *_figures(v["enabled"])) for v in sensor["views"]]


def _figures(m: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        f"{m['samples']:.0f}", _number(m.get("correlation"), ".3f"),
        _number(m.get("fit_percent"), ".1f"), _number(m.get("rmse"), ".4g"),
    )  # fmt: skip


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else f"{value:{form}}"


def _paper(parts: Mapping[str, Any]) -> str:
    rows = paper.beside_ours(parts)
    own = paper.same_structure(parts)
    if own:
        rows.append(own)
    cells = "".join(
        "<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows
    )
    note = (
        "The paper measured a real engine and does not give its data; ours are "
        f"{parts['data']['source']} recordings, so numbers can be set beside each other, "
        "not compared as one experiment."
    )
    return f"<table><tr><th></th><th>paper</th><th>here</th></tr>{cells}</table>" + paragraph(
        note, "note"
    )


def _free(part: Mapping[str, Any]) -> str:
    rows = [
        (f"inputs to lag {t['longest']}, outputs to lag {t['lags']}, "
         f"layers {'-'.join(map(str, t['hidden'])) or 'none'}",
         str(t["n_weights"]), f"{t['rmse']:.4f}")
        for t in part["tries"][:12]
    ]  # fmt: skip
    text = (
        "The 29 models share the paper's grid of lags and layers. Beside them, memory and size "
        "were chosen by the data as o2train fit does: a walk over structures with boxed input "
        f"lags and a linear path, each trained shortly and judged in free run; {len(part['tries'])}"
        f" were tried. It ended at {part['structure']} ({part['n_weights']} weights), trained from "
        f"{len(part['starts'])} starts."
    )
    return (
        "<h2>Memory and size chosen by the data</h2>" + paragraph(text)
        + table(rows, ("the best that were tried", "weights", "free-run RMSE, short training"), 0)
    )  # fmt: skip


def _choice(parts: Mapping[str, Any]) -> str:
    choice, shipped = parts["choice"], parts["shipped"]
    rows = [
        (
            c["name"] if c["number"] is None else f"{c['number']}  {c['name']}",
            str(c["n_weights"]), f"{c['validation_rmse']:.4f}",
            "yes" if i in choice["equal"] else "no", "yes" if c["forgets"] else "no",
            _number(c["after"]["enabled"].get("correlation"), ".3f"),
            _number(c["after"]["enabled"].get("rmse"), ".4g"),
            _number(c["after"]["all"].get("fit_percent"), ".1f"),
        )
        for i, c in enumerate(choice["candidates"])
    ]  # fmt: skip
    head = ("candidate", "weights", "validation RMSE", "equal to the best", "forgets",
            "test R", "test RMSE", "fit, all samples, %")  # fmt: skip
    limits = [(k, f"{v['value']:.4g} {v['unit']}".strip(" -"), v["origin"])
              for k, v in shipped["limits"].items()]  # fmt: skip
    out = [
        "<h2>The choice</h2>", paragraph(choice["reason"]), table(rows, head, choice["chosen"]),
        paragraph(
            "Validation RMSE: free run on the validation blocks, scaled units, weighted as in the "
            "training; it alone decides. Equal: within one standard error over the blocks or 1 % "
            f"of the best. Test figures are of {choice['test']} and were looked at by nobody "
            "before; R and RMSE where the monitor judges. The 29 models see at most the training "
            "samples set for the study, the free structure all of them.", "note"),
    ]  # fmt: skip
    if limits:
        out += ["<h3>Decision limits in the model card</h3>",
                table(limits, ("limit", "value", "from"))]  # fmt: skip
    return "\n".join(out)


def _closed_loop(choice: Mapping[str, Any]) -> str:
    rows = []
    for c in choice["candidates"]:
        if "before" not in c:
            continue
        before, after = (c[k]["enabled"] for k in ("before", "after"))
        gain = None
        if before.get("rmse") and after.get("rmse") is not None:
            gain = 100 * (1 - after["rmse"] / before["rmse"])
        rows.append(
            (c["name"], _number(before.get("rmse"), ".4g"), _number(after.get("rmse"), ".4g"),
             "–" if gain is None else f"{gain:+.0f} %",
             _number(before.get("correlation"), ".3f"), _number(after.get("correlation"), ".3f"),
             c["stage"], f"{c['gap']:.2g} ({c['gap_limit']:.2g})")
        )  # fmt: skip
    head = ("model", "RMSE one-step only", "after closed loop", "less", "R one-step only",
            "after", "best stage", "two histories apart (limit)")  # fmt: skip
    text = (
        f"The same start of each model on {choice['test']} in free run, before and after training "
        "on the simulation error with exact gradients, horizons growing from 5 to 1,000 samples. "
        "The stage with the lowest free-run validation error is kept. Two histories: the largest "
        "difference of two predictions from random histories after 50 samples."
    )
    chosen = choice["chosen"] if len(rows) == len(choice["candidates"]) else None
    return "<h2>What closed-loop training gains</h2>" + paragraph(text) + table(rows, head, chosen)


def _beside(parts: Mapping[str, Any]) -> str:
    if "skipped" in parts["beside"]:
        return ""
    choice = parts["choice"]
    name = choice["candidates"][choice["chosen"]]["name"]
    return "<h2>Beside linear models</h2>" + beside_table(parts["beside"], name)


def _sensor(sensor: Mapping[str, Any]) -> str:
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
        "<h2>Model against sensor</h2>" + paragraph(text)
        + picture(sensor_figure(sensor["views"], sensor), f"Free run, {label(sensor)}")
        + paragraph(stable)
    )  # fmt: skip


def _faulty(sensor: Mapping[str, Any]) -> str:
    rows = [("healthy", f"{sensor['healthy_on']}, {sensor['healthy_source']}",
             *_residual_cells(sensor["healthy"]))]  # fmt: skip
    rows += [(f["name"].replace("_", " "), f["how"], *_residual_cells(f))
             for f in sensor["faults"]]  # fmt: skip
    head = ("", "how", "samples", "mean", "std", "windows", "|mean| ≥ Jμ, %", "std ≥ Jσ, %",
            "both, %")  # fmt: skip
    j = sensor["limits"]
    limit = f"Jμ = {j['j_mu']:.3g} and Jσ = {j['j_sigma']:.3g}" if "j_mu" in j else "no limits"
    afterwards = any(f["how"] == "put on afterwards" for f in sensor["faults"])
    text = (
        "Residuals as in figure 7 of the paper: measured minus predicted, where the monitor "
        f"judges, over windows of 50 samples. The paper's rule wants both limits exceeded "
        f"({limit}, dotted); it misses slow and late sensors, which is why the monitor also has "
        "the response rule (README)."
    )
    note = (
        "The faults were put on the recorded output afterwards: the control loop did not answer "
        "to them. Recordings with the fault in the loop can be given with --faulty."
    )
    shown = [f["view"] for f in sensor["faults"]][:6]
    return "".join(
        [
            "<h2>Healthy and faulty</h2>", paragraph(text),
            paragraph(note, "note") if afterwards else "", table(rows, head),
            picture(residual_figure(sensor), "Residuals, healthy (grey) and faulty; dotted: ± Jμ"),
            picture(window_figure(sensor), "Windows of 50 residuals; dotted: the limits Jμ, Jσ"),
            picture(sensor_figure(shown, sensor), "Model against the faulty sensor"),
        ]
    )  # fmt: skip


def _residual_cells(r: Mapping[str, Any]) -> tuple[str, ...]:
    beyond = [f"{100 * r['beyond'][k]:.1f}" for k in ("mean", "std", "both")]
    return (str(r["samples"]), _number(r["mean"], ".4f"), _number(r["std"], ".4f"),
            str(r["windows"]), *beyond)  # fmt: skip


def _steady(result: Mapping[str, Any]) -> str:
    rows = []
    for name, m in result["models"].items():
        on = m["enabled"] if "rmse" in m["enabled"] else m["all"]
        rows.append(
            (f"{name} training", str(m["samples"]), _number(m["own_validation_rmse"], ".4g"),
             *_figures(on)[1:], _number(m["all"].get("fit_percent"), ".1f"),
             f"{100 * m['outside']:.1f} %")
        )  # fmt: skip
    head = ("the paper's structure", "training samples", "own validation RMSE", "R", "fit, %",
            "RMSE", "fit, all samples, %", "outside its range")  # fmt: skip
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
    note = (
        "Outside its range: share of test samples with an input that the training never reached; "
        "inputs are clipped there."
    )
    return (
        "<h2>Steady training, transient use</h2>" + paragraph(text) + table(rows, head)
        + paragraph(verdict) + paragraph(note, "note")
        + picture(steady_figure(result), f"Free run on transient driving, {label(result)}")
    )  # fmt: skip
