"""Text and page of a calibration."""

from typing import Any

from monitor.base.counts import counted, plain
from training.limits.evaluation import alarms_in_words
from training.limits.rates import in_words
from training.pages.drawing import Drawing, axis, layer, plot
from training.pages.page import page


def as_text(result: dict[str, Any]) -> str:
    """Return the lines that the command prints."""
    lines = [
        f"limit {own['name']}: {plain(own['value'])} {own['unit']}".rstrip(" -")
        + f", was {'none' if own['before'] is None else plain(own['before'])} ({own['origin']})"
        for own in result["limits"]
    ]
    lines += [
        f"{kind} {name}: codes {codes}; paper's rule fails {failed} of {windows} windows"
        for kind in ("healthy", "faulty")
        for name, windows, failed, _, codes in map(cells, result[kind])
    ]
    lines.append(alarms_in_words(result["false_alarms"]))
    if result["faulty"]:
        lines.append(detection(result))
    if told := result.get("emissions"):
        rows = (f"  {f}, {at}, single cars {each}, {by}" for f, at, each, by in emissions(told))
        own = ", ".join(f"{key} = {value:g}" for key, value in told["response"].items())
        top = f"tailpipe above {told['limit']:g} times that with a sound sensor ({told['source']}):"
        lines += [top, *rows, f"settings that follow, [response]: {own}"]
    return "\n".join(lines)


def emissions(told: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return each fault, the severity at which the emissions first cross the limit, that of single
    cars, and the pollutant.
    """

    def words(severity: float | None, unit: str, before: str = "") -> str:
        if severity is None:
            return "not reached"
        return f"{before}{plain(severity, 2)} {unit}".removesuffix(" -")

    return [
        (
            name,
            words(each["severity"], each["unit"], "from "),
            "; ".join(words(s, each["unit"]) for s in each["of_each_car"]),
            each["pollutant"] or "-",
        )
        for name, each in told["faults"].items()
    ]


def detection(result: dict[str, Any]) -> str:
    """Return in words how many faulty drives have a code, and how many their own."""
    found, known = result["found"], sum(bool(row["fault"]) for row in result["faulty"])
    named = f", {found['named']} of {known} with the right name alone" if known else ""
    return f"faulty drives with a code: {in_words(found)}{named}"


def verdict(result: dict[str, Any]) -> str:
    """Return what the new limits say of the drives."""
    alarms, found = result["false_alarms"], result["found"]
    faulty = f", and {found['events']} of {found['trials']} faulty ones" if found["trials"] else ""
    simulated = " Simulated recordings are among them." if result["simulated"] else ""
    drives = counted(alarms["trials"], "healthy drive")
    return f"With the new limits {alarms['events']} of {drives} have a code{faulty}.{simulated}"


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return a drive's name, windows, those that the paper's rule fails, evidence, and codes."""
    name = row["recording"] + (" (simulated)" if row["source"] == "simulated" else "")
    if row["fault"]:
        severity = "" if row["severity"] is None else f" {row['severity']:g}"
        name += f", {row['fault']}{severity}"
    evidence = "-" if row["evidence"] is None else f"{row['evidence']:.1f}"
    codes = ", ".join(row["codes"]) or ("none" if row["completed"] else "none, not completed")
    return name, str(row["windows"]), str(row["paper_failed"]), evidence, codes


def as_page(result: dict[str, Any]) -> str:
    """Return the calibration as a page."""
    return page(
        "calibration.html",
        f"Calibration of {result['model']}",
        verdict=verdict(result),
        confidence=f"{alarms_in_words(result['false_alarms'])}.",
        kind="bad" if result["false_alarms"]["events"] else "good",
        warnings=result["warnings"],
        result=result,
        drives={kind: [cells(row) for row in result[kind]] for kind in ("healthy", "faulty")},
        detection=detection(result) if result["faulty"] else "",
        emissions=emissions(result["emissions"]) if "emissions" in result else [],
        evidence=_evidence_figure(result),
    )


def _evidence_figure(result: dict[str, Any]) -> Drawing:
    """Draw the largest evidence for a fault in each drive, and what sets a code."""
    layers, first = [], 1
    for kind, color in (("healthy", "measured"), ("faulty", "failed")):
        if seen := [row["evidence"] for row in result[kind] if row["evidence"] is not None]:
            drives = [float(first + i) for i in range(len(seen))]
            layers.append(layer("points", x=drives, y=seen, label=kind, color=color))
            first += len(seen)
    layers.append(layer("rule", y=[result["needed"]], dash=[5, 4], color="ink", width=1.25))
    return Drawing([plot("largest evidence for a fault", *layers, x=axis("drive"), height=280)])
