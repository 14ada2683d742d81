"""The result of a matrix as one self-contained page: targets first, then every table."""

from collections.abc import Sequence

from training.limits.rates import Figures
from training.limits.targets import LIMIT_SEVERITY, at_limit
from training.pages.page import page, paragraph, picture, table
from training.studies.matrix import figures, page_beside
from training.studies.matrix.plan import SEVERITIES, Matrix
from training.studies.matrix.report import NBSP, cells, number, percent, seconds
from training.studies.matrix.rows import Row
from training.studies.matrix.tables import of_kind
from training.studies.matrix.targets import PLACES, of_faults

HEAD = ("target", "wanted", "found", "95 % bounds", "drives", "")
FOUND = (
    "drives",
    "detected, %",
    "named rightly, %",
    "target missed by",
    "or alike, %",
    "enabled s",
    "driving s",
    "completed, %",
)


def as_page(found: Figures, rows: Sequence[Row]) -> str:
    """Return the page of a result and its rows."""
    body = [
        _head(found),
        table([_target(target) for target in found["targets"]], HEAD),
        paragraph(
            "Missed says by how much what was found falls short. Proved is a target whose bound "
            "meets it, too. Bounds, here and in brackets below, are two-sided 95 %, after Clopper "
            "and Pearson; of medians, order statistics. Both count drives as independent, though "
            "a vehicle has several.",
            "note",
        ),
        _detection(found["detection"]),
        _ambient(found["by_ambient"]),
        _times(rows),
        _confusion(found["confusion"]),
        page_beside.healthy(found["healthy"]),
        page_beside.rules(found),
        page_beside.roc(found["roc"]),
    ]
    return page("Simulated matrix of drives and faults", "\n".join(body))


def _target(target: Figures) -> tuple[str, ...]:
    what, where, *numbers, verdict = cells(target)
    return f"{where}: {what}", *(each.replace(" ", NBSP) for each in numbers), verdict


def _head(found: Figures) -> str:
    n, matrix = found["drives"], found["matrix"]
    last = matrix["first_vehicle"] + matrix["vehicles"] - 1
    on = found["rules_set_on"]
    return "\n".join(
        [
            paragraph(
                f"Everything here is simulated: {n['all']} drives, {n['hours']:.0f} h, of "
                f"{matrix['vehicles']} simulated vehicles ({matrix['first_vehicle']} to {last}). "
                "None of these vehicles and seeds trained the model or set the literature's rules. "
                + _developed(matrix["first_vehicle"])
                + "The legislated speed traces are the ones the model also saw in training, driven "
                "by other drivers with other gear changes."
            ),
            paragraph(
                f"{n['reference']} healthy drives came first, in the order of time, for each "
                f"vehicle's reference to learn from; then {n['healthy']} healthy and {n['faulty']} "
                f"faulty ones ({', '.join(found['faulty_cycles']) or 'none'}), each judged with an "
                "empty fault memory. Each drive has its own fuel (0 to 10 % ethanol), weather "
                "(mild 5 to 30 °C, hot 35 to 43 °C, cold start at −15 to −5 °C, altitude at 72 to "
                "80 kPa), driver and noise. Half of the healthy sensors are aged within their "
                "specification: up to 0.15 s of lag and 0.1 s of dead time, together 0.2 s, 15 % "
                "less amplitude, 0.008 of offset; those with faults are new otherwise."
            ),
            paragraph(
                f"Model {found['model']} {found['model_sha256'][:12]}, configuration "
                f"{found['config_sha256'][:12]}, code {found['code_sha256'][:12]}, seeds from "
                f"{matrix['seed']}. The literature's rules were set on vehicles "
                f"{on['vehicles'][0]} to {on['vehicles'][1]}, with new and with aged sensors, for "
                f"{100 * on['false_alarm_rate']:g} % false alarms per window.",
                "note",
            ),
            "<h2>Targets</h2>",
        ]
    )


def _detection(detection: Sequence[Figures]) -> str:
    parts = ["<h2>Detection against severity</h2>"]
    if any(d["fault"] in LIMIT_SEVERITY for d in detection):
        parts.append(
            picture(
                figures.severity_figure(detection),
                "Simulated. Share of drives with a code (full, with 95 % bounds) and named rightly "
                "(hollow, dotted); dashed: the severity from which a fault must be found, and 99 %",
            )
        )
    for placement, place in PLACES.items():
        rows = [
            _cells(f"{d['fault']} {d['severity']:g}{', limit' if d['at_limit'] else ''}", d)
            for d in sorted(detection, key=lambda d: list(SEVERITIES).index(d["fault"]))
            if d["placement"] == placement
        ]
        if rows:
            parts += [
                f"<h3>Simulated, {place}</h3>",
                table(rows, ("fault, severity", *FOUND)),
            ]
    parts.append(
        paragraph(
            "Detected is a drive with any code at its end; named rightly one whose every code "
            "carries exactly the fault's name; or alike also one that names it among those that "
            "could not be told apart. Times are medians in seconds, drives without a code "
            "count as never; enabled time is what the monitor may judge.",
            "note",
        )
    )
    return "\n".join(parts)


def _developed(first_vehicle: int) -> str:
    if first_vehicle >= Matrix().first_vehicle:
        return ""
    return "Vehicles with such low numbers serve development, so these figures are not final. "


def _missed(d: Figures) -> str:
    """Return by how much drives whose fault must be found miss their targets."""
    if not d.get("beyond_limit", True):
        return ""
    short = ("detected", "named", "time")
    missed = [
        f"{name} never" if t["missed_by"] is None else f"{name} {number(t['missed_by'], t['unit'])}"
        for name, t in zip(short, of_faults(d, ""), strict=True)
        if t["met"] is False
    ]
    return ", ".join(missed).replace(" ", NBSP) or "-"


def _ambient(by_ambient: Sequence[Figures]) -> str:
    rows = [_cells(f"{d['ambient']}, {PLACES[d['placement']]}", d) for d in by_ambient]
    title = "<h3>Simulated, at or beyond the limit, by weather</h3>"
    return title + table(rows, ("weather", *FOUND))


def _cells(name: str, d: Figures) -> tuple[str, ...]:
    return (
        name.replace(" ", NBSP),
        str(d["detected"]["trials"]),
        percent(d["detected"]),
        percent(d["named"]),
        _missed(d),
        percent(d["named_or_alike"], bounds=False),
        seconds(d["enabled_s"]),
        seconds(d["driving_s"], bounds=False),
        percent(d["completed"], bounds=False),
    )


def _times(rows: Sequence[Row]) -> str:
    times: dict[str, dict[str, list[float | None]]] = {}
    for r in of_kind(rows, "faulty"):
        if at_limit(r["fault"], r["severity"]):
            own = times.setdefault(r["placement"], {}).setdefault(r["fault"], [])
            own.append(r["first_code_enabled_s"])
    if not times:
        return ""
    caption = "Simulated. Faults at their limit severity; dashed: the median wanted"
    return "<h2>Time to the code</h2>" + picture(figures.time_figure(times), caption)


def _confusion(confusion: dict[str, Figures]) -> str:
    parts = ["<h2>Names given</h2>"]
    for placement, place in PLACES.items():
        own = confusion[placement]
        if not own["driven"]:
            continue
        parts.append(
            picture(
                figures.confusion_figure(own),
                f"Simulated, {place}: names given, percent of the drives at or beyond the limit, "
                "of electrical faults, and of healthy drives",
            )
        )
        if own["several"]:
            rows = [(s["driven"], " + ".join(s["names"]), str(s["drives"])) for s in own["several"]]
            parts.append(table(rows, (f"several names, {place}", "names", "drives")))
    return "\n".join(parts)
