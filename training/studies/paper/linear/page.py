"""The section on linear baselines: words, tables and figures from the stored result."""

import html
from collections.abc import Sequence
from typing import Any

import numpy as np

from training.pages.page import paragraph, picture, table
from training.studies.paper.linear.figures import (
    TITLES,
    Result,
    correlations,
    criteria,
    example,
    fit_chart,
    impulse_figure,
    singular_values,
)


def section(result: Result) -> str:
    """Return the HTML of this part from what ``linear`` returned."""
    return "\n".join(
        [
            f"<h2>Linear baselines of {html.escape(result['output'])}</h2>",
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


def _number(value: float | None, form: str = ".1f") -> str:
    return "–" if value is None else f"{value:{form}}"


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
    parts.append(picture(fit_chart(result, ranges), "Free-run fit on the test samples"))
    parts.append(picture(example(result), "A part of the test samples with the free runs"))
    if 1 < len(each) <= 30:
        parts.append(table(each, ("fit in %", *(TITLES[n] for n in models))))
    return "".join(parts)


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
        impulse_figure(result), "Impulse responses, 99 % bands shaded, dead time dashed"
    )
    return paragraph(words, "note") + table(rows, head) + figure


def _delays(delays: Sequence[int]) -> str:
    return str(delays[0]) if len(set(delays)) == 1 else " ".join(map(str, delays))


def _arx(result: Result) -> str:
    found = result["arx"]
    rows = [
        (
            TITLES[name],
            str(c["na"]),
            str(c["nb"]),
            _delays(c["nk"]),
            str(result["models"][name]["parameters"]),
        )
        for name, c in found["choices"].items()
    ]
    edge = [
        TITLES[n]
        for n, c in found["choices"].items()
        if c["na"] >= (most := result["largest_order"])
        or c["nb"] >= (2 * most if n == "arx_free_run" else most)
    ]
    words = (
        f"{found['candidates']} models: na and nb from 1 to {result['largest_order']}, dead times "
        "the same for all inputs or those of the table above. Sum of squares is that of one-step "
        "predictions on the validation samples; AIC = log V + 2 d/N, MDL = V (1 + d log N / N) "
        "with the training loss V. The last row is chosen for its free run on the validation "
        "samples, with na from 0 and nb up to twice as many; it is the reference beside every NARX."
    )
    if edge:
        words += f" At the largest order tried: {'; '.join(edge)}; more would fit one step closer."
    figure = picture(
        criteria(result), "Criteria over the number of parameters, best of each number"
    )
    return (
        paragraph(words, "note") + table(rows, ("choice", "na", "nb", "nk", "parameters")) + figure
    )


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
        (
            s["start"],
            str(s["nf"]),
            str(s["nb"]),
            _delays(s["nk"]),
            _number(s["training_rmse"], ".4g"),
            _number(s["validation_rmse"], ".4g"),
        )
        for s in starts[:8]
    ]
    head = ("output error started from", "nf", "nb", "nk", "RMSE, training", "RMSE, validation")
    figure = picture(
        singular_values(result), "Singular values; free-run error over the number of states"
    )
    return paragraph(words) + figure + table(rows, head, 0)


def _last(value: float | None) -> float:
    return float("inf") if value is None else value


def _residuals(result: Result) -> str:
    found = result["residuals"]
    rows = [(TITLES[name], *_verdicts(tests)) for name, tests in found.items()]
    head = (
        "model",
        "residuals are white",
        "p (Ljung-Box)",
        "lags outside 99 %",
        "residuals do not depend on the inputs",
        "largest correlation",
        "inputs that follow the residuals",
    )
    words = (
        "On the test samples, at the level of 1 %: one-step residuals of ARX and state space, "
        "simulation residuals of output error, which models no disturbance and need not be white. "
        "Whiteness rejected: the past still tells something of the residual. Independence "
        "rejected: an input acts in a way the model lacks, in its dynamics, its dead time or its "
        "curvature. An input that follows the residuals is made from the output, so that a loop "
        "is closed, or shares a cause with it. On many samples the tests see what no use of the "
        "model would notice; the size of the correlation says how much it is."
    )
    figure = picture(correlations(result), "Residual correlations with their 99 % bands")
    return table(rows, head) + paragraph(words, "note") + figure


def _verdicts(tests: dict[str, Any]) -> list[str]:
    """Return the cells of one model: whiteness, p, lags, independence, correlation, feedback."""
    white, each = tests["whiteness"], tests["independence"]
    p = white["p_value"]
    sizes = [max(abs(c) for c in t["correlation"][len(t["lags"]) // 2 :]) for t in each]
    worst = int(np.argmax(sizes))
    return [
        "rejected" if white["rejected"] else "not rejected",
        "below 1e-16" if p < 1e-16 else f"{p:.2g}",
        f"{white['outside']} of {white['lags']}",
        _named("rejected", [t["input"] for t in each if t["rejected"]], len(each)),
        f"{sizes[worst]:.2f}, {each[worst]['input']}",
        _named("", [t["input"] for t in each if t["feedback"]], len(each)),
    ]


def _named(word: str, names: Sequence[str], total: int) -> str:
    if not names:
        return f"not {word}" if word else "none"
    named = ", ".join(names) if len(names) < 3 else f"{len(names)} of {total}"
    return f"{word} for {named}" if word else named
