"""The report of a fleet: a page and the same figures as JSON."""

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import polars as pl

from monitor.base.counts import counted, plain
from monitor.base.files.outputs import write_text
from monitor.base.signals import OUTPUT
from monitor.judge.enable import statement
from training.fleet.page import distribution_figures, outliers, summary
from training.fleet.page.outliers import Standing
from training.fleet.run import windows_path
from training.fleet.worker_kit import WorkerKit, tools_of
from training.jobs import run_folder
from training.limits.rates import Figures
from training.pages.numbers import MISSING, NBSP
from training.pages.page import breakable, page

ROWS: Final = 40  # of a table, at most
SHOWN: Final = 10  # of them before the rest is folded


def write(
    out: Path, kit: WorkerKit, run: Mapping[str, Any], replay: Callable[[str], str]
) -> tuple[Path, Path, Figures]:
    """Write page and JSON beside the table ``out``; return their paths and figures.

    run : what ``run.run`` returned
    replay : returns the command that judges the recording of a path
    """
    recordings, tools = pl.read_parquet(out, glob=False), tools_of(kit)
    output = tools.model.card.output
    unit = "lambda" if output.name == OUTPUT else output.unit
    standing = outliers.standings(recordings)
    found = summary.summary(recordings, run, standing)
    html, tree = out.with_suffix(".html"), out.with_suffix(".json")
    run_folder.write_json(tree, found, indent=1)
    judged = recordings.filter(pl.col("error").is_null())
    named, draw = outliers.named(standing), distribution_figures
    numbers = {vehicle: i for i, vehicle in enumerate(named, 1)}
    content = page(
        "fleet.html",
        "Fleet",
        verdict=_verdict(found),
        confidence=_confidence(found),
        extent=_extent(found),
        found=found,
        distributions=draw.distribution_figure(judged, windows_path(out), tools.limits)
        if len(judged)
        else None,
        drives=[_drive(each, replay) for each in found["drives_with_code"][:ROWS]],
        more_drives=len(found["drives_with_code"]) - ROWS,
        standing=standing,
        standings=draw.standing_figure(standing, numbers) if standing else None,
        named=_named(named, unit),
        unit=unit,
        beyond=len(named) - ROWS,
        rows=ROWS,
        shown=SHOWN,
        least=(outliers.LEAST_VEHICLES, outliers.LEAST_WINDOWS),
        rarest=_rarest(found["not_completed"]["held"]),
        footer=[
            f"Model {found['model']} {found['model_sha256'][:12]}, configuration "
            f"{found['config_sha256'][:12]}, code {found['code_sha256'][:12]}, list of recordings "
            f"{found['manifest_sha256'][:12]}"
        ],
    )
    write_text(html, content)
    return html, tree, found


def _verdict(found: Figures) -> str:
    """Return how many vehicles have a code, and which code most of them have."""
    vehicles = len({each["vehicle"] for each in found["drives_with_code"]})
    text = f"A code stands in {vehicles:,} of {counted(found['vehicles'], 'vehicle')}"
    if not vehicles:
        reason = ": no judged recording ends with one"
    else:
        often = Counter(c for each in found["drives_with_code"] for c in sorted({*each["codes"]}))
        ((code, drives),) = often.most_common(1)
        names = [each["fault"] for each in found["codes"] if each["code"] == code]
        reason = (
            f", in {found['with_code']['events']:,} of {found['judged']:,} judged recordings; most "
            f"often {code} ({' or '.join(names).replace('_', ' ')}), in "
            f"{counted(drives, 'recording')}"
        )
    failed = counted(found["errors"], "recording")
    return f"{text}{reason}." + (f" {failed} could not be judged." if found["errors"] else "")


def _confidence(found: Figures) -> str:
    """Return in how many recordings a test came to its end; silence of the others is no health."""
    done = found["completed"]
    if done["rate"] is None:
        return "none: no recording was judged."
    low, high = (100.0 * done[k] for k in ("low", "high"))
    return (
        f"the response test came to a decision in {100.0 * done['rate']:.0f} % of the judged "
        f"recordings (95 % bounds {low:.0f} to {high:.0f}); no code in the others is no health."
    )


def _extent(found: Figures) -> str:
    text = (
        f"{counted(found['drives'], 'drive')} of {counted(found['vehicles'], 'vehicle')}: "
        f"{found['judged']:,} judged, {found['errors']:,} not; {found['hours']:,.1f} h of driving, "
        f"of which {found['enabled_hours']:,.1f} h may be judged, {found['windows']:,} windows."
    )
    if not found["simulated"]:
        return text
    share = "All" if found["simulated"] == found["judged"] else f"{found['simulated']:,}"
    return f"{text} {share} of the judged recordings are simulated."


def _named(named: dict[str, list[tuple[Standing, int]]], unit: str) -> list[tuple[str, ...]]:
    """Return each vehicle that stands out, by which statistics, their medians and distances."""
    return [
        (
            f"{number}{NBSP}{vehicle}",
            ", ".join(each.statistic.title for each, _ in by),
            ", ".join(
                f"{plain(each.values[i])} {unit * each.statistic.has_unit}".strip()
                for each, i in by
            ),
            ", ".join(f"{each.distance[i]:+.1f}" for each, i in by),
        )
        for number, (vehicle, by) in enumerate(list(named.items())[:ROWS], 1)
    ]


def _drive(each: Figures, replay: Callable[[str], str]) -> tuple[str, ...]:
    """Return vehicle, codes, the command for the drive's page, its start, time of first code."""
    set_at, path, start = each["first_code_s"], each["path"], each["start"]
    return (
        breakable(each["vehicle"]),
        ", ".join(
            f"{code}{NBSP}{fault.replace('_', ' ')} ({state})"
            for code, fault, state in zip(
                each["codes"], each["faults"], each["states"], strict=True
            )
        ),
        breakable(replay(path)),
        start[:16].replace("T", NBSP) if start else MISSING,
        "earlier drive" if set_at is None else f"{set_at:.0f}{NBSP}s",
    )


def _rarest(held: Mapping[str, float | None]) -> str:
    """Return the four enable conditions that hold least often, with their shares."""
    shares = {name: share for name, share in held.items() if share is not None}
    worst = sorted(shares, key=lambda name: shares[name])[:4]
    return "; ".join(
        f"{statement(name)}, {100.0 * shares[name]:.0f} % of the time" for name in worst
    )
