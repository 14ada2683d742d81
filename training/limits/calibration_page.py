"""Text and page of a calibration."""

from typing import Any, Final

import numpy as np

from monitor.base.counts import counted
from training.pages.drawing import Drawing, axis, layer, plot
from training.pages.numbers import with_unit
from training.pages.page import page

EMISSIONS: Final = "tailpipe above {limit:g} times that with a sound sensor ({source}):"


def as_text(result: dict[str, Any]) -> str:
    """Return the lines that the command prints."""
    lines = [sentence(result)]
    for limit in result["limits"]:
        before = "none" if limit["before"] is None else f"{limit['before']:.4g}"
        lines.append(
            f"limit {limit['name']}: {limit['value']:.4g} {limit['unit']}, was {before} "
            f"({limit['origin']})"
        )
    for kind in ("healthy", "faulty"):
        for row in result[kind]:
            name, windows, failed, share, bounds, codes = cells(row)
            lines.append(
                f"{kind} {name}: paper's rule {failed} of {windows} windows, {share} ({bounds}); "
                f"codes {codes}"
            )
    if result["detection"]:
        lines.append(detection(result))
    lines.append(monitor(result))
    if told := result.get("emissions"):
        rows = (f"  {', '.join(row)}" for row in emissions(told))
        own = ", ".join(f"{key} = {value:g}" for key, value in told["response"].items())
        lines += [EMISSIONS.format(**told), *rows, f"settings that follow, [response]: {own}"]
    return "\n".join(lines)


def emissions(told: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return each fault, the severity at which the emissions first cross the limit, that of single
    cars, and the pollutant.
    """

    def words(severity: float | None, unit: str) -> str:
        return "not reached" if severity is None else f"{severity:.2g} {unit.strip('-')}".strip()

    return [
        (
            name,
            f"from {words(each['severity'], each['unit'])}".replace("from not", "not"),
            "single cars " + "; ".join(words(s, each["unit"]) for s in each["of_each_car"]),
            each["pollutant"] or "-",
        )
        for name, each in told["faults"].items()
    ]


def sentence(result: dict[str, Any]) -> str:
    """Return the false alarms in words."""
    f = result["false_alarms"]
    simulated = " (simulated recordings among them)" if result["simulated"] else ""
    paid = (
        ", the choice of the pair paid for" if f["bound_confidence"] > result["confidence"] else ""
    )
    drives = (
        f"{f['bound_drives']:.3g} drawing whole drives (bootstrap)"
        if f["alarms"]
        else "without an alarm drawing whole drives bounds nothing"
    )
    return (
        f"Wanted: at most {result['false_alarms_wanted']:g} false alarms of the paper's rule per "
        f"window. Of {f['windows']} healthy windows in {counted(f['drives'], 'drive')}{simulated} "
        f"{f['alarms']} alarm; upper 95 % bound {f['bound']:.3g} if windows are independent "
        f"(Clopper and Pearson{paid}), {drives}. {held_out(f['held_out'], f['windows'])}"
    )


def holds(result: dict[str, Any]) -> bool:
    """Return whether the bound of the false alarms keeps the wanted rate."""
    return bool(result["false_alarms"]["bound"] <= result["false_alarms_wanted"])


def verdict(result: dict[str, Any]) -> str:
    """Return whether the limits keep the wanted false-alarm rate, and why."""
    f, wanted = result["false_alarms"], result["false_alarms_wanted"]
    found = "keep" if holds(result) else "are not shown to keep"
    return (
        f"The limits {found} the wanted rate of at most {wanted:g} false alarms per window: "
        f"{f['alarms']} of {f['windows']} healthy windows in {counted(f['drives'], 'drive')} alarm."
    )


def _confidence(result: dict[str, Any]) -> str:
    f = result["false_alarms"]
    return (
        f"with {100 * f['bound_confidence']:.4g} % at most {f['bound']:.3g} per window if windows "
        f"are independent. {held_out(f['held_out'], f['windows'])}"
    )


def held_out(failed: int | None, windows: int) -> str:
    """Return in words the limits' findings on drives that did not set them."""
    if failed is None:
        return "The drives are too few to set limits without one of them."
    return (
        f"With limits set without the drive in question, {failed} of {windows} windows fail, "
        f"{100 * failed / windows:.2g} %."
    )


def detection(result: dict[str, Any]) -> str:
    """Return the detection in words."""
    d = result["detection"]
    return (
        f"The paper's rule finds {d['failed']} of {d['windows']} faulty windows, "
        f"{100 * d['share']:.1f} % (95 % bounds {100 * d['low']:.1f} to {100 * d['high']:.1f} % "
        "if windows are independent); the limits were chosen on these windows. "
        f"{held_out(d['held_out'], d['windows'])}"
    )


def monitor(result: dict[str, Any]) -> str:
    """Return in words how many drives the monitor's own rules give a code."""
    good, bad = result["monitor"]["healthy"], result["monitor"]["faulty"]
    largest = "none" if good["largest_evidence"] is None else f"{good['largest_evidence']:.1f}"
    text = (
        f"The monitor's own rules give {good['with_code']} of {good['drives']} healthy drives a "
        f"code, at most {100 * good['high']:.1f} % with 97.5 % confidence; their largest "
        f"evidence for a fault is {largest}."
    )
    if bad["drives"]:
        text += (
            f" They give {bad['with_code']} of {bad['drives']} faulty drives a code "
            f"({100 * bad['low']:.1f} to {100 * bad['high']:.1f} %)."
        )
    return text


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return a drive's name, windows, failed windows, their share, its bounds, and codes."""
    name = row["recording"] + (" (simulated)" if row["source"] == "simulated" else "")
    if row["fault"]:
        severity = "" if row["severity"] is None else f" {row['severity']:g}"
        name += f", {row['fault']}{severity}"
    share = "-" if row["share"] is None else f"{100 * row['share']:.1f} %"
    bounds = f"{100 * row['share_low']:.1f} to {100 * row['share_high']:.1f} %"
    codes = ", ".join(row["codes"]) or ("none" if row["completed"] else "none, not completed")
    return name, str(row["windows"]), str(row["paper_failed"]), share, bounds, codes


def as_page(result: dict[str, Any]) -> str:
    """Return the calibration as a page."""
    return page(
        "calibration.html",
        f"Calibration of {result['model']}",
        verdict=verdict(result),
        confidence=_confidence(result),
        kind="good" if holds(result) else "bad",
        warnings=result["warnings"],
        result=result,
        sentence=sentence(result),
        drives={kind: [cells(row) for row in result[kind]] for kind in ("healthy", "faulty")},
        detection=detection(result) if result["detection"] else "",
        monitor=monitor(result),
        emissions=emissions(result["emissions"]) if "emissions" in result else [],
        windows=_window_figure(result),
    )


def _window_figure(result: dict[str, Any]) -> Drawing:
    limits = {limit["name"]: limit for limit in result["limits"]}
    unit, layers = limits["j_mu"]["unit"], []
    for kind, color in (("faulty", "failed"), ("healthy", "measured")):
        mean, std = (np.array([v for r in result[kind] for v in r[k]]) for k in ("mean", "std"))
        shown = slice(None, None, max(1, len(mean) // 1500))
        if len(mean):
            points = {"x": np.abs(mean)[shown], "y": std[shown], "label": kind, "color": color}
            layers.append(layer("points", **points, alpha=0.6))
    j_mu, j_sigma = limits["j_mu"]["value"], limits["j_sigma"]["value"]
    right, top = (
        1.3 * max([own, *(v for each in layers for v in each[k])])
        for k, own in (("x", 2.0 * j_mu), ("y", 2.0 * j_sigma))
    )
    corner = {"x": [right, j_mu, j_mu], "y": [j_sigma, j_sigma, top]}
    layers.append(layer("line", **corner, label="limits", color="ink", width=1.5))
    label = with_unit("|mean of residual|", unit)
    over = axis(label, low=0.0, high=right, scale="symlog", linear=max(j_mu, 1e-9))
    up = axis(scale="log", high=top)
    return Drawing([plot(with_unit("std of residual", unit), *layers, x=over, y=up, height=360)])
