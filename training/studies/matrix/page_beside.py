"""The second half of the page: healthy drives, rules beside each other, ROC."""

from collections.abc import Sequence
from typing import Any

from monitor.judge.enable import CONDITIONS
from training.limits.alarm_rules import OWN, TITLES
from training.limits.rates import Figures
from training.pages.page import paragraph, picture, table
from training.studies.matrix import figures
from training.studies.matrix.plan import PLACEMENTS
from training.studies.matrix.report import NBSP, percent, seconds
from training.studies.matrix.tables import MONITOR
from training.studies.matrix.targets import PLACES

FALSE_HEAD = (
    "healthy drives",
    "drives",
    "with a code",
    "%",
    "per 1,000 h",
    "at most (95 %)",
    "confirmed",
    "test completed, %",
)


def _false_cells(name: str, own: Figures) -> tuple[str, ...]:
    false, per = own["false"], own["false_1000_h"]
    rates = (
        ("-", "-")
        if per["per_1000_h"] is None
        else (f"{per['per_1000_h']:.2f}", f"{per['high']:.2f}")
    )
    return (
        name.replace(" ", NBSP),
        str(false["trials"]),
        str(false["events"]),
        percent(false),
        *rates,
        str(own["confirmed"]),
        percent(own["completed"]),
    )


def healthy(good: Figures) -> str:
    """Return false codes by weather and cycle, and why drives were not judged."""
    named = {
        "all": f"all, {good['all']['vehicles']} vehicles",
        "new": "new sensors",
        "aged": "aged sensors",
        "reference": "while the references learn",
    }
    rows = [_false_cells(title, good[key]) for key, title in named.items()]
    rows += [_false_cells(f"{c['ambient']}, {c['cycle']}", c) for c in good["cells"]]
    parts = ["<h2>Healthy drives (simulated)</h2>", table(rows, FALSE_HEAD)]
    parts.append(
        paragraph(
            "Per 1,000 h of driving, the bound is a Poisson process's. Confirmed are codes that a "
            "vehicle's fault memory would have confirmed had it lasted from drive to drive.",
            "note",
        )
    )
    weather = [n["ambient"] for n in good["not_held"]]
    why = [(name, *(f"{100.0 * n[name]:.1f} %" for n in good["not_held"])) for name in CONDITIONS]
    why += [
        ("all hold: judged", *(f"{100.0 * n['enabled']:.1f} %" for n in good["not_held"])),
        ("windows in a drive", *(f"{n['windows']:.0f}" for n in good["not_held"])),
    ]
    parts += [
        "<h3>Why healthy drives were not judged</h3>",
        table(why, ("share of the time a condition does not hold", *weather)),
    ]
    if good["codes"]:
        parts += [
            "<h3>False codes</h3>",
            table(
                [_code(c) for c in good["codes"]],
                (
                    "drive",
                    "vehicle",
                    "seed",
                    "cycle",
                    "weather",
                    "sensor",
                    "codes",
                    "names",
                    "driving s",
                ),
            ),
        ]
    return "\n".join(parts)


def _code(code: dict[str, Any]) -> tuple[str, ...]:
    aged = code["aged"]
    sensor = (
        "new"
        if aged is None
        else (
            f"lag {aged['lag_s']:.2f} s, dead time {aged['dead_time_s']:.2f} s, "
            f"gain {aged['gain']:.2f}, offset {aged['offset_lambda']:+.3f}"
        )
    )
    return (
        str(code["number"]),
        str(code["vehicle"]),
        str(code["seed"]),
        code["cycle"],
        code["ambient"],
        sensor,
        ", ".join(code["codes"]),
        ", ".join(code["faults"]),
        f"{code['first_code_driving_s']:.0f}",
    )


def rules(found: Figures) -> str:
    """Return the monitor and the literature's rules on the same drives."""
    rows = []
    for r in found["rules"]:
        cell = [
            MONITOR if r["rule"] == MONITOR else TITLES[r["rule"]],
            f"{r['false_drives']['events']} of {r['false_drives']['trials']}",
            percent(r["false_windows"], bounds=False),
        ]
        for placement in PLACEMENTS:
            own = r[placement]
            cell += [
                percent(own["detected"]),
                percent(own["windows"], bounds=False),
                seconds(own["enabled_s"]),
            ]
        rows.append(tuple(cell))
    head = ["rule", "healthy drives that alarm", "healthy windows, %"]
    for place in ("loop", "afterwards"):
        head += [f"{place}: drives, %", f"{place}: windows, %", f"{place}: enabled s"]
    return (
        "<h2>Rules beside each other (simulated)</h2>"
        + table(rows, head)
        + paragraph(
            "The same healthy drives and the same drives at or beyond the limit for all. A rule of "
            "the literature alarms in a drive where two windows in a row alarm; windows are single "
            "ones. The paper's rule, |mean| and standard deviation of the residual both at their "
            "limits, stands here twice: with the limits of the model card, and with limits set on "
            "drives with faults at the limit severity like the other rules.",
            "note",
        )
    )


def roc(curves: Sequence[Figures]) -> str:
    """Return figures and areas of the curves of every fault and rule."""
    if not curves:
        return ""
    parts = ["<h2>ROC of each fault and rule (simulated)</h2>"]
    for placement, place in PLACES.items():
        own = [c for c in curves if c["placement"] == placement]
        if not own:
            continue
        faults = list(dict.fromkeys(c["fault"] for c in own))
        at = {(c["fault"], c["rule"]): c for c in own}
        parts.append(
            picture(
                figures.roc_figure(curves, placement),
                f"Simulated, {place}, limit severity. A drive's score is the largest that two "
                "windows in a row reach",
            )
        )
        rows = [
            (
                fault,
                *(
                    f"{at[fault, rule]['area']:.3f} / {100 * at[fault, rule]['at_1_percent']:.0f}"
                    if at[fault, rule]["area"] is not None
                    else "-"
                    for rule in TITLES
                ),
            )
            for fault in faults
        ]
        parts.append(table(rows, (f"area / % found at 1 % false, {place}", *TITLES.values())))
    parts.append(
        paragraph(
            f"The monitor's own scores are two ({', '.join(OWN)}), one for each of its rules: the "
            "evidence for a faulty sensor, and the mean residual.",
            "note",
        )
    )
    return "\n".join(parts)
