"""The result of a matrix as one self-contained page: targets first, then every table."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.studies.rules.alarms import OWN, TITLES
from benchmarks.studies.sensor import detection_figures
from benchmarks.studies.sensor.goals import LIMIT_SEVERITY, at_limit
from benchmarks.studies.sensor.matrix_result import cells, number
from benchmarks.studies.sensor.plan import PLACEMENTS, Matrix
from benchmarks.studies.sensor.rows import Row
from benchmarks.studies.sensor.severities import SEVERITIES
from benchmarks.studies.sensor.tables import MONITOR, of_kind
from benchmarks.studies.sensor.targets import PLACES, of_faults
from monitor.judge.enable import CONDITIONS
from training.limits.rates import Figures
from training.pages.numbers import NBSP
from training.pages.page import page, template_of

MISSED_SHOWN: Final = 3
Times = dict[str, dict[str, list[float | None]]]
TEMPLATES: Final = Path(__file__).parents[1] / "templates"


def as_page(found: Figures, rows: Sequence[Row]) -> str:
    """Return the page of a result and its rows."""
    met = [target["met"] for target in found["targets"]]
    judged = [m for m in met if m is not None]
    return page(
        template_of(TEMPLATES / "matrix.html"),
        "Simulated matrix of drives and faults",
        verdict=f"{sum(judged)} of {len(judged)} targets are met"
        + (f", {len(met) - len(judged)} not judged" if len(judged) < len(met) else "")
        + _farthest(found["targets"]),
        confidence=_confidence(found["targets"]),
        kind="good" if all(judged) else "bad",
        found=found,
        targets=[_target(target) for target in found["targets"]],
        is_development=found["matrix"]["first_vehicle"] < Matrix().first_vehicle,
        has_severities=any(d["fault"] in LIMIT_SEVERITY for d in found["detection"]),
        detection=sorted(found["detection"], key=lambda d: list(SEVERITIES).index(d["fault"])),
        missed=_missed,
        times=_times(rows),
        conditions=CONDITIONS,
        places=PLACES,
        placements=PLACEMENTS,
        rule_titles=TITLES,
        own_rules=OWN,
        monitor=MONITOR,
        draw=detection_figures,
        footer=[
            f"Model {found['model']} {found['model_sha256'][:12]}, configuration "
            f"{found['config_sha256'][:12]}, code {found['code_sha256'][:12]}, seeds from "
            f"{found['matrix']['seed']}"
        ],
    )


def _farthest(targets: Sequence[Figures]) -> str:
    """Return which targets are missed, as the reason of the verdict."""
    missed = [f"{t['where']}: {t['what']}" for t in targets if t["met"] is False]
    if not missed:
        return "."
    more = f" and {len(missed) - MISSED_SHOWN} more" if len(missed) > MISSED_SHOWN else ""
    return f". Missed: {'; '.join(missed[:MISSED_SHOWN])}{more}."


def _confidence(targets: Sequence[Figures]) -> str:
    """Return how many of the met targets are proved."""
    met = [t for t in targets if t["met"]]
    proved = sum(t["proved"] is not False for t in met)
    return (
        f"{proved} of {len(met)} met targets are proved (their 95 % bounds meet them, too); the "
        "others need more drives. Everything here is simulated."
    )


def _target(target: Figures) -> tuple[str, ...]:
    what, where, *numbers, verdict = cells(target)
    return f"{where}: {what}", *(each.replace(" ", NBSP) for each in numbers), verdict


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
    return ", ".join(missed).replace(" ", NBSP) or "–"


def _times(rows: Sequence[Row]) -> Times:
    """Return the time to the first code of each drive at the limit, by placement and fault."""
    times: Times = {}
    for r in of_kind(rows, "faulty"):
        if at_limit(r["fault"], r["severity"]):
            own = times.setdefault(r["placement"], {}).setdefault(r["fault"], [])
            own.append(r["first_code_enabled_s"])
    return times
