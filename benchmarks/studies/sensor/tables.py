"""Tables, figures and targets of the detection matrix.

A drive counts as detected if any code is set at its end. It counts as named rightly if every code
carries exactly the fault's name.
"""

from collections.abc import Sequence
from typing import Final

from benchmarks.studies import targets
from benchmarks.studies.report import DEVELOPMENT, Report, Section
from benchmarks.studies.rules.alarms import FALSE_ALARM_RATE, TITLES
from benchmarks.studies.sensor.plan import CALIBRATION_VEHICLES, PLACEMENTS, Matrix
from benchmarks.studies.sensor.severities import ELECTRICAL, LIMIT_SEVERITY, at_limit, beyond_limit
from benchmarks.studies.tables import (
    AND,
    Row,
    answers,
    confusion,
    grouped,
    mean,
    median,
    of_kind,
    split,
)
from benchmarks.studies.targets import Target
from monitor.judge.enable import CONDITIONS
from training.limits.rates import Figures, per_1000_h, rate
from training.pages.drawing import Drawing, Layer, axis, layer, plot
from training.pages.numbers import words

HEALTHY, NONE = "healthy", "none"
ORDER: Final = (HEALTHY, NONE, *LIMIT_SEVERITY, *ELECTRICAL)
MONITOR: Final = "monitor"
PLACES: Final = {"loop": "fault in the loop", "after": "fault put on afterwards"}
DETECTED: Final = 0.99  # least share of trials detected within one WLTC
NAMED: Final = 0.95  # least share of trials with exactly the right name
MEDIAN_ENABLED_S: Final = 60.0  # longest median enabled time to the code
COMPLETED: Final = 0.95  # least share of healthy WLTCs with a completed test
HEALTHY_DRIVES, HEALTHY_VEHICLES = 500, 50  # least numbers that must stay without a false code
NOTE: Final = (
    "Detected: a drive that ends with any code. Named rightly: every code carries exactly the "
    "fault's name; or alike: also a drive that names it among faults that could not be told apart. "
    "Times are medians to the first code; enabled time is what the monitor may judge."
)


def report(matrix: Matrix, model: str, rows: Sequence[Row]) -> Report:
    """Return the report of a run."""
    n = {kind: len(of_kind(rows, kind)) for kind in ("reference", "healthy", "faulty")}
    last = matrix.first_vehicle + matrix.vehicles - 1
    about = [
        f"{len(rows)} simulated drives, {sum(r['driving_s'] for r in rows) / 3600.0:.0f} h, model "
        f"{model}: {n['reference']} that vehicles' references learn from, {n['healthy']} healthy, "
        f"{n['faulty']} faulty",
        f"Vehicles {matrix.first_vehicle} to {last}; none of them and no seed trained the model or "
        "set the literature's rules, which are set on vehicles "
        f"{CALIBRATION_VEHICLES[0]} to {CALIBRATION_VEHICLES[-1]} for "
        f"{100.0 * FALSE_ALARM_RATE:g} % false alarms per window. Each drive has its own fuel (E0 "
        "to E10), weather, driver and noise, and an empty fault memory. Half of the healthy "
        "sensors are aged within their specification.",
    ]
    if matrix.first_vehicle < Matrix().first_vehicle:
        about.append(DEVELOPMENT)
    good = of_kind(rows, "healthy")
    detected = detection(rows)
    sections = [
        Section("Detection against severity", detected, NOTE, severity_figure(detected)),
        Section(
            "At or beyond the limit, by weather",
            grouped(_wanted(rows), ("placement", "ambient"), figures),
        ),
        *(
            Section(f"Names given, {place}", given, figure=confusion(given, ORDER))
            for placement, place in PLACES.items()
            if (given := names(rows, placement))
        ),
        Section("Healthy drives", healthy(rows)),
        Section("Conditions that do not hold, share of the time", not_held(good)),
        Section("Healthy drives with a code", [_short(r) for r in good if r["codes"]]),
        Section("Rules of the literature", side_by_side(rows)),
    ]
    return Report(
        "Simulated matrix of drives and faults", about, assess(rows), sections if rows else ()
    )


def named_rightly(row: Row) -> bool:
    """Return whether the drive's codes carry exactly the name of its fault."""
    return bool(row["faults"] == [row["fault"]])


def figures(rows: Sequence[Row]) -> Figures:
    """Return the rates of detection, right names and completion, and the median times to a code."""
    n = len(rows)
    alike = sum(r["fault"] in (*r["faults"], *r["also"]) for r in rows)
    return {
        "detected": rate(sum(bool(r["codes"]) for r in rows), n),
        "named": rate(sum(map(named_rightly, rows)), n),
        "named_or_alike": rate(alike, n),
        "completed": rate(sum(r["completed"] for r in rows), n),
        "enabled_s": median([r["first_code_enabled_s"] for r in rows]),
        "driving_s": median([r["first_code_driving_s"] for r in rows]),
    }


def detection(rows: Sequence[Row]) -> list[Figures]:
    """Return ``figures`` for every placement, fault and severity."""
    keys = ("placement", "fault", "severity")
    faulty = sorted(of_kind(rows, "faulty"), key=lambda r: tuple(r[k] for k in keys))
    return grouped(faulty, keys, figures)


def _wanted(rows: Sequence[Row], placement: str | None = None) -> list[Row]:
    """Return the drives with a fault at or beyond its limit severity."""
    return [
        r
        for r in of_kind(rows, "faulty")
        if placement in (None, r["placement"]) and beyond_limit(r["fault"], r["severity"])
    ]


def healthy(rows: Sequence[Row]) -> list[Figures]:
    """Return the rates of false codes and completion, of all healthy drives and of parts."""
    good, first = of_kind(rows, "healthy"), of_kind(rows, "reference")
    parts = {
        "all": good,
        "new sensors": [r for r in good if r["aged"] is None],
        "aged sensors": [r for r in good if r["aged"] is not None],
        "reference drives": first,
    }
    parts |= {f"{a}, {c}": own for (a, c), own in split(good, "ambient", "cycle").items()}
    return [{"drives": title, **_false(own)} for title, own in parts.items()]


def _false(rows: Sequence[Row]) -> Figures:
    events = sum(bool(r["codes"]) for r in rows)
    wltc = [r for r in rows if r["cycle"] == "wltc_3b"]
    return {
        "vehicles": len({r["vehicle"] for r in rows}),
        "with a code": rate(events, len(rows)),
        "per 1000 h": per_1000_h(events, sum(r["driving_s"] for r in rows)),
        "confirmed": confirmed(rows),
        "completed": rate(sum(r["completed"] for r in rows), len(rows)),
        "completed WLTC": rate(sum(r["completed"] for r in wltc), len(wltc)),
    }


def confirmed(rows: Sequence[Row]) -> int:
    """Return the number of codes that would be confirmed if vehicles kept their fault memory.

    A code is confirmed if it is set in a drive and in the vehicle's previous drive; drives in which
    no test completed and no code was set are skipped.
    """
    before: dict[int, set[str]] = {}
    count = 0
    for r in sorted(rows, key=lambda r: int(r["number"])):
        codes = set(r["codes"])
        count += len(codes & before.get(r["vehicle"], set()))
        if codes or r["completed"]:
            before[r["vehicle"]] = codes
    return count


def not_held(good: Sequence[Row]) -> list[Figures]:
    """Return how much of the time could be judged, and what kept the rest, by weather."""

    def shares(own: list[Row]) -> Figures:
        held = {"enabled": mean(r["enabled_s"] / r["driving_s"] for r in own)}
        held |= {name: mean(r["not_held"][name] for r in own) for name in CONDITIONS}
        return held | {"windows": mean(r["windows"] for r in own)}

    return grouped(good, ("ambient",), shares)


def _short(row: Row) -> Figures:
    keys = ("number", "vehicle", "cycle", "ambient", "codes", "faults", "first_code_driving_s")
    return {k: row[k] for k in keys} | {"aged": row["aged"] is not None}


def names(rows: Sequence[Row], placement: str) -> list[Figures]:
    """Return the answers of one placement: to healthy drives, and to faults to be found."""
    electrical = [
        r
        for r in of_kind(rows, "faulty")
        if r["placement"] == placement and r["fault"] in ELECTRICAL
    ]
    chosen = [*_wanted(rows, placement), *electrical, *of_kind(rows, "healthy")]
    return answers(((r["fault"] or HEALTHY, AND.join(r["faults"]) or NONE) for r in chosen), ORDER)


def side_by_side(rows: Sequence[Row]) -> list[Figures]:
    """Return false alarms and detections of the monitor and of every literature rule."""
    good = of_kind(rows, "healthy")
    found = []
    for rule in (MONITOR, *TITLES):
        alarms = sum(_alarm_s(r, rule) is not None for r in good)
        figure: Figures = {
            "rule": TITLES.get(rule, rule),
            "false": rate(alarms, len(good)),
            "false per 1000 h": per_1000_h(alarms, sum(r["driving_s"] for r in good)),
            "false windows": _windows(good, rule),
        }
        for placement in PLACEMENTS:
            own = _wanted(rows, placement)
            times_s = [_alarm_s(r, rule) for r in own]
            figure |= {
                f"{placement}, found": rate(sum(t is not None for t in times_s), len(own)),
                f"{placement}, windows": _windows(own, rule),
                f"{placement}, enabled s": median(times_s),
            }
        found.append(figure)
    return found


def _alarm_s(row: Row, rule: str) -> float | None:
    """Return the enabled seconds until the rule's first alarm in a drive, None without one."""
    at: float | None = (
        row["first_code_enabled_s"] if rule == MONITOR else row["alarms_enabled_s"][rule]
    )
    return at


def _windows(rows: Sequence[Row], rule: str) -> Figures:
    return rate(sum(r["failed_windows"][rule] for r in rows), sum(r["windows"] for r in rows))


def assess(rows: Sequence[Row]) -> list[Target]:
    """Return the targets in the order of the report."""
    found = []
    for placement, place in PLACES.items():
        every = _wanted(rows, placement)
        limit = [r for r in every if at_limit(r["fault"], r["severity"])]
        for own, scope in ((limit, "at the limit"), (every, "at or beyond the limit")):
            n, where = figures(own), f"{place}, {scope}"
            found += [
                targets.share("detected within one drive", where, n["detected"], least=DETECTED),
                targets.share("named rightly", where, n["named"], least=NAMED),
                targets.time(
                    "median enabled time to the code", where, n["enabled_s"], MEDIAN_ENABLED_S
                ),
            ]
    good = _false(of_kind(rows, "healthy"))
    drives, vehicles = good["with a code"]["trials"], good["vehicles"]
    enough = drives >= HEALTHY_DRIVES and vehicles >= HEALTHY_VEHICLES
    wanted = f"{HEALTHY_DRIVES} of {HEALTHY_VEHICLES} are wanted"
    why = "" if enough else f"{drives} drives of {vehicles} vehicles, {wanted}"
    where = f"healthy drives of {vehicles} vehicles"
    codes = {"pending": good["with a code"]["events"], "confirmed": good["confirmed"]}
    for what, n in codes.items():
        title, count = f"drives with a {what} code", float(n) if drives else None
        found.append(Target(title, where, "drives", count, trials=drives, most=0.0, why=why))
    done = good["completed WLTC"]
    where = "healthy WLTCs, all weather"
    return [*found, targets.share("test completed", where, done, least=COMPLETED)]


def severity_figure(detected: Sequence[Figures]) -> Drawing | None:
    """Draw the share detected (with bounds) and named rightly (thin) over severity."""
    faults = [name for name in LIMIT_SEVERITY if any(d["fault"] == name for d in detected)]
    plots = []
    for fault in faults:
        own = [d for d in detected if d["fault"] == fault]
        ticks = [(t, f"{t:g}") for t in sorted({d["severity"] for d in own})]
        layers = [
            each
            for placement, color in zip(PLACEMENTS, ("measured", "predicted"), strict=True)
            for each in _severities([d for d in own if d["placement"] == placement], color)
        ]
        plots.append(
            plot(
                f"{words(fault)}, share of drives",
                layer("rule", x=[LIMIT_SEVERITY[fault]], y=[DETECTED], color="quiet", dash=[5, 4]),
                *layers,
                x=axis("severity: s, gain that is left, or offset", scale="log", ticks=ticks),
                y=axis(low=-0.03, high=1.05),
                height=150,
            )
        )
    return Drawing(plots, columns=(1, 1, 1)) if plots else None


def _severities(own: Sequence[Figures], color: str) -> list[Layer]:
    """Return what one placement of a fault adds to its plot."""
    x = [d["severity"] * (0.98 if color == "measured" else 1.02) for d in own]
    share, low, high = ([d["detected"][k] for d in own] for k in ("rate", "low", "high"))
    bounds = {
        "x": [v for each in x for v in (each, each, None)],
        "y": [v for pair in zip(low, high, strict=True) for v in (*pair, None)],
    }
    name = PLACES[own[0]["placement"]] if own else ""
    named = [d["named"]["rate"] for d in own]
    return (
        [
            layer("line", **bounds, color=color),
            layer("line", x=x, y=share, color=color, width=1.5),
            layer("points", x=x, y=share, label=name, color=color),
            layer("line", x=x, y=named, color=color, width=0.7),
        ]
        if own
        else []
    )
