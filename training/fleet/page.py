"""A fleet's report as one self-contained page."""

from collections.abc import Sequence
from pathlib import Path

import polars as pl

from training.fleet import figures, outliers
from training.fleet.outliers import Standing
from training.limits.rates import Figures
from training.pages.page import page, paragraph, picture, table
from training.studies.matrix.report import NBSP, TO, percent

ROWS = 40  # of a table, at most


def as_page(
    found: Figures, recordings: pl.DataFrame, windows: Path, standing: Sequence[Standing]
) -> str:
    """Return the page of a fleet's summary and its tables."""
    judged = recordings.filter(pl.col("error").is_null())
    body = [_head(found)]
    if len(judged):
        body += [
            _codes(found),
            _standing(found, standing),
            "<h2>Distribution of the statistics</h2>",
            picture(
                figures.distribution_figure(judged, windows, found["limits"]),
                "Red: the limit as it is (dashed) and as proposed below (full). The outermost bars "
                "gather what lies beyond them",
            ),
            _limits(found["limits"]),
        ]
    body += [_not_judged(found), _cost(found)]
    return page("Fleet", "\n".join(body))


def _head(found: Figures) -> str:
    lines = [
        f"{found['drives']:,} recordings of {found['vehicles']:,} vehicles: {found['judged']:,} "
        f"judged, {found['errors']:,} could not be; {found['hours']:,.1f} h of driving, of which "
        f"{found['enabled_hours']:,.1f} h may be judged, {found['windows']:,} windows. "
        f"{found['with_code']['events']:,} recordings end with a code."
    ]
    if found["simulated"]:
        share = "All" if found["simulated"] == found["judged"] else f"{found['simulated']:,}"
        lines.append(f"{share} of the judged recordings are simulated.")
    rests = (
        f"Model {found['model']} {found['model_sha256'][:12]}, configuration "
        f"{found['config_sha256'][:12]}, code {found['code_sha256'][:12]}, list of recordings "
        f"{found['manifest_sha256'][:12]}."
    )
    return "\n".join([*(paragraph(line) for line in lines), paragraph(rests, "note")])


def _codes(found: Figures) -> str:
    rows = [
        (
            each["code"],
            each["fault"].replace("_", " "),
            f"{each['drives']:,}",
            f"{each['vehicles']:,}",
            f"{each['confirmed']:,}",
            _plain(each["rate"]["per_1000_h"]),
            _plain(each["rate"]["high"]),
            ", ".join(each["examples"]),
        )
        for each in found["codes"]
    ]
    head = (
        "code",
        "fault",
        "recordings",
        "vehicles",
        "confirmed",
        "per 1,000 h",
        "at most (95 %)",
        "for example",
    )
    completed = paragraph(
        f"The response test completed in {percent(found['completed'])} % of the judged recordings.",
    )
    if not rows:
        return f"<h2>Codes</h2>{completed}" + paragraph("No code is set at the end of any.")
    note = (
        "Recordings at whose end a code is pending or confirmed; the bound is a Poisson process's."
    )
    return f"<h2>Codes</h2>{completed}{table(rows, head)}{paragraph(note, 'note')}"


def _standing(found: Figures, standing: Sequence[Standing]) -> str:
    title = "<h2>Vehicles that stand out</h2>"
    if not standing:
        return title + paragraph(
            f"Too few vehicles to compare: {outliers.LEAST_VEHICLES} are wanted with a drive "
            f"of {outliers.LEAST_WINDOWS} windows."
        )
    named = outliers.named(standing)
    chance = 100.0 * found["standing_out"]["chance"]
    method = (
        f"A vehicle's value is the median over its drives with at least "
        f"{outliers.LEAST_WINDOWS} windows; its distance from the fleet's median is counted in "
        "robust standard deviations (1.4826 times the median absolute deviation). The limits "
        f"({', '.join(f'{s.statistic.title} {s.limit:.2f}' for s in standing)}) are those beyond "
        "which, in a fleet of so many sound vehicles with normally distributed values, any "
        f"vehicle at all lies with a chance of {chance:g} %, over all statistics together."
    )
    parts = [title]
    if named:
        parts.append(table(*_named(named)))
        if len(named) > ROWS:
            parts.append(paragraph(f"… and {len(named) - ROWS} more, in the JSON."))
    else:
        parts.append(paragraph("None."))
    numbers = {vehicle: i for i, vehicle in enumerate(named, 1)}
    caption = "Every vehicle; dashed: the limits; numbers are those of the table"
    parts += [
        picture(figures.standing_figure(standing, numbers), caption),
        paragraph(method, "note"),
    ]
    return "\n".join(parts)


def _named(
    named: dict[str, list[tuple[Standing, int]]],
) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for number, (vehicle, by) in enumerate(list(named.items())[:ROWS], 1):
        what = ", ".join(each.statistic.title for each, _ in by)
        values = ", ".join(f"{each.values[i]:.4g}" for each, i in by)
        far = ", ".join(f"{each.distance[i]:+.1f}" for each, i in by)
        rows.append((f"{number}{NBSP}{vehicle}", what, values, far))
    return rows, ("vehicle", "by", "its median", "robust standard deviations")


def _limits(limits: Sequence[Figures]) -> str:
    rows = []
    for each in limits:
        bounds = [each["quantile_low"], each["quantile_high"]]
        low, high = ("?" if b is None else f"{b:.4g}" for b in bounds)
        estimate = "-" if each["quantile"] is None else f"{each['quantile']:.4g} ({low}{TO}{high})"
        wanted = f"{each['needed']:,} wanted"
        rows.append(
            (
                f"{each['name']}: {each['title']}",
                f"{each['values']:,} {each['of']}s",
                f"{each['now']:.4g}",
                _percent(each["now_rate"]),
                estimate.replace(" ", NBSP),
                wanted if each["proposed"] is None else f"{each['proposed']:.4g}",
            )
        )
    wished = f"{100.0 * limits[0]['wished']:g} %"
    head = (
        "limit on",
        "values",
        "now",
        "reached now, % (95 %)",
        f"quantile for {wished} (95 %)",
        f"proposed for {wished}",
    )
    note = (
        f"From vehicles without a code, taken as sound. Proposed is the lowest limit that at most "
        f"{wished} of sound windows (of drives for the offset) reach, with 95 % confidence: by "
        "Clopper and Pearson's bound, and by drawing whole vehicles. The quantile and its bounds "
        "are order statistics, ? beyond the largest value. The paper's rule fails a window that "
        "reaches both of its limits; a code needs more than one window."
    )
    return f"<h2>Proposed limits</h2>{table(rows, head)}{paragraph(note, 'note')}"


def _percent(rate: Figures) -> str:
    """Return a rate that may be small in percent, with its bounds."""
    if rate["rate"] is None:
        return "-"
    found, low, high = (_plain(100.0 * rate[k], 2) for k in ("rate", "low", "high"))
    return f"{found}{NBSP}({low}{TO}{high})"


def _plain(value: float, digits: int = 3) -> str:
    """Return a number with so many digits that count, and never an exponent for a large one."""
    return f"{value:,.0f}" if value >= 10.0 ** (digits - 1) else f"{value:.{digits}g}"


def _not_judged(found: Figures) -> str:
    parts = ["<h2>What was not judged, and why</h2>"]
    rows = [
        (
            each["reason"],
            f"{each['recordings']:,}",
            ", ".join(Path(p).name for p in each["examples"]),
        )
        for each in found["not_judged"]
    ]
    if rows:
        parts.append(table(rows[:ROWS], ("could not be judged", "recordings", "for example")))
        if len(rows) > ROWS:
            parts.append(paragraph(f"… and {len(rows) - ROWS} more reasons, in the JSON."))
    else:
        parts.append(paragraph("Every recording could be judged."))
    without = found["not_completed"]
    if without["drives"]:
        held = {k: v for k, v in without["held"].items() if v is not None}
        worst = sorted(held, key=lambda name: held[name])[:4]
        said = ", ".join(f"{name} {100.0 * held[name]:.0f} %" for name in worst)
        parts.append(
            paragraph(
                f"In {without['drives']:,} judged recordings the response test reached no "
                f"decision, in {without['without_window']:,} of them no window was filled. How "
                f"often the enable conditions held there, the rarest: {said}."
            )
        )
    return "\n".join(parts)


def _cost(found: Figures) -> str:
    each = found["per_1000_h"]
    if each is None:
        return ""
    steps = each["core_seconds"]
    rows = [(f"processor, {step}", f"{seconds:,.1f} s") for step, seconds in steps.items()]
    rows.append(("read", f"{each['read_bytes'] / 1e6:,.0f} MB"))
    rows.append(("written", f"{each['written_bytes'] / 1e6:,.1f} MB"))
    said = f"One core judges {each['times_real_time']:,.0f} times as fast as was driven."
    return (
        "<h2>Cost of 1,000 hours of driving</h2>"
        + table(rows)
        + paragraph(said)
        + paragraph("Processor time of the workers, as measured in this run.", "note")
    )
