"""Tables and targets of the gap study: confusion matrix, rates by effect and size, wrong names."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

from benchmarks.studies import targets
from benchmarks.studies.report import DEVELOPMENT, Report, Section
from benchmarks.studies.tables import Row, answers, confusion, split
from benchmarks.studies.targets import Target
from benchmarks.studies.workflow.answers import (
    AMONG,
    CLASSES,
    SUSPECTED,
    answer,
    closed,
    done,
    errs,
    hidden,
    large,
    right,
    right_or_among,
    right_or_beside_fault,
    size,
    wrong_names,
)
from benchmarks.studies.workflow.case import ADD
from benchmarks.studies.workflow.plan import HEALTHY_DRIVES, UNKNOWN, Study
from training.greybox.effects import LIBRARY
from training.limits.rates import Figures, rate

FINAL: Final = 5000  # vehicles with lower numbers serve development
SECONDS_MOST: Final = {"greybox": 15.0, "narx": 60.0}
SLOW: Final = 0.95  # quantile of the seconds per case that the target limits
ORDER: Final = ("nothing", "no_gap", *LIBRARY, *UNKNOWN, "two effects", AMONG, "ambiguous")


def report(study: Study, rows: Sequence[Row]) -> Report:
    """Return the report of a study, for as many cases as there are."""
    errors = [r for r in rows if r["error"] is not None]
    noises = [r["noise"] for r in rows if r["noise"] is not None]
    noise = f"{min(noises):.4f} to {max(noises):.4f}" if noises else "not known"
    failed = f", {len(errors)} of them ended in an error and answer nothing" if errors else ""
    fitted = "the healthy ones"
    if study.fitted_with_effect:
        fitted = "the case's own recordings, but those that the workflow holds out"
    good = " The sensor is declared good." if study.sensor_known_good else ""
    about = [
        f"{len(rows)} of {study.count} simulated cases reached, base {study.base}, "
        f"{study.vehicles} vehicles{failed}",
        f"A case is {study.drives} recordings of {study.minutes:g} minutes, as decoded from the "
        f"bus; about half of them begin with the start of the engine. The base is fitted to "
        f"{fitted}; {HEALTHY_DRIVES} healthy recordings of the vehicle are given.{good} Vehicles "
        f"from {study.first_vehicle}, seeds from {study.seed}.",
        "The gap is the RMS by which the hidden effect moves the error of the base of the healthy "
        "recordings. The noise is what the naming's ceiling leaves of the residual of the healthy "
        f"recordings, {noise} in phi. Gap closed is the share of the excess squared error on "
        "recordings that are held out which the new model takes away. Effects that may be faults "
        f"are added, too ({', '.join(ADD)}).",
    ]
    if study.first_vehicle < FINAL:
        about.append(DEVELOPMENT)
    given, wide = (
        answers(((hidden(r), answer(r)) for r in own), ORDER) for own in (rows, large(done(rows)))
    )
    sections = [
        Section("Hidden and answered", given, figure=confusion(given, ORDER)),
        Section("Hidden and answered, gap at least twice the noise", figure=confusion(wide, ORDER)),
        Section("By effect and size of the gap", by_size(rows)),
        Section("Two effects at once", two(rows)),
        Section("Wrong names", wrong(rows)),
        Section("Errors", [{k: r[k] for k in ("number", "kind", "error")} for r in errors]),
    ]
    title = f"Simulated study of the gap workflow, base {study.base}"
    return Report(title, about, assess(rows, study.base), sections)


def by_size(rows: Sequence[Row]) -> list[Figures]:
    """Return a row for every effect and class of the gap, then rows for all effects together."""
    effect = done(rows, "effect")
    named = [{**r, "effect": r["hidden"][0], "gap": size(r)} for r in effect]
    every = [{**r, "effect": "all effects"} for r in named]
    order = {name: i for i, name in enumerate((*LIBRARY, "all effects"))}
    cells = sorted(
        split([*named, *every], "effect", "gap").items(),
        key=lambda cell: (order[cell[0][0]], -CLASSES.index(cell[0][1])),
    )
    return [
        {
            "effect": name,
            "gap": gap,
            "cases": len(own),
            "right": sum(map(right, own)),
            "right or among": sum(map(right_or_among, own)),
            "wrong": sum(bool(wrong_names(r)) for r in own),
            "not named": dict(Counter(r["verdict"] for r in own if r["verdict"] != "named")),
        }
        for (name, gap), own in cells
    ]


def wrong(rows: Sequence[Row]) -> list[Figures]:
    """Return the cases with at least one wrong name."""
    keys = ("number", "vehicle", "kind", "hidden", "severities", "fault", "gap_over_noise", "names")
    return [{k: r[k] for k in keys} for r in done(rows) if wrong_names(r)]


def two(rows: Sequence[Row]) -> list[Figures]:
    """Return the number of cases with two hidden effects by result."""
    found = Counter(_of_two(r) for r in done(rows, "two"))
    return [{"answer": each, "cases": n} for each, n in found.most_common()]


def _of_two(row: Row) -> str:
    if wrong_names(row):
        return "a wrong name"
    if right(row):
        return "both right"
    return "one right, nothing wrong" if row["names"] else str(row["verdict"])


def assess(rows: Sequence[Row], base: str) -> list[Target]:
    """Return the targets in the order of the report; rows with an error are left out.

    base : kind of the base model, ``greybox`` or ``narx``
    """
    effect = done(rows, "effect")
    big = large(effect)
    small = [r for r in effect if size(r) == CLASSES[1]]
    null, unknown = done(rows, "null"), large(done(rows, "unknown"))
    onset, fault = done(rows, "onset"), done(rows, "fault")
    named = [r for r in big if right(r)]
    given = [(r, name) for r in done(rows) for name in r["names"]]
    rightly = [name not in wrong_names(r) for r, name in given]
    wide, narrow = "one effect, gap at least twice the noise", "one effect, gap 1 to 2 times"
    outside, start = "outside the library, gap at least twice", "sensor fault from the start"
    look = "right, among, or what the suspected fault is said to look like"
    among, beside = map(right_or_among, big), map(right_or_beside_fault, big)
    return [
        _share("right of all names given", "everything hidden", rightly, least=0.98),
        _share("right name", wide, map(right, big), least=0.90),
        _share("right or in the ambiguous set", wide, among, least=0.95),
        _share(look, wide, beside, least=0.95),
        _share("right name", narrow, map(right, small), least=0.85),
        _share("an effect named", "nothing hidden", map(_names, null), most=0.01),
        _share(
            "unknown_effect",
            outside,
            (r["verdict"] == "unknown_effect" for r in unknown),
            least=0.9,
        ),
        _share("a wrong name", outside, map(_names, unknown), most=0.05),
        _share("taken for an effect", "sensor fault with an onset", map(_names, onset), most=0.01),
        _share("suspected", start, (r["verdict"] == SUSPECTED for r in fault), least=0.95),
        _share("added to the model", start, (bool(r["added"]) for r in fault), most=0.0),
        *_closing(named, "rightly named, gap at least twice"),
        *_closing(big, f"all of {wide}"),
        *_closing([r for r in effect if errs(r)], "one effect, excess at least twice the noise"),
        *_detection(named),
        targets.quantile(
            "seconds per case, 95 % of them",
            "all",
            [r["seconds"] for r in done(rows)],
            SLOW,
            "s",
            most=SECONDS_MOST[base],
        ),
    ]


def _names(row: Row) -> bool:
    return bool(row["names"])


def _share(what: str, where: str, events: Iterable[bool], **wanted: float) -> Target:
    every = list(events)
    return targets.share(what, where, rate(sum(every), len(every)), **wanted)


def _closing(rows: Sequence[Row], where: str) -> list[Target]:
    shares = [share for r in rows if (share := closed(r)) is not None]
    return [
        targets.quantile("gap closed, median", where, shares, 0.5, least=0.90),
        targets.quantile("gap closed, tenth percentile", where, shares, 0.1, least=0.60),
    ]


def _detection(rows: Sequence[Row]) -> list[Target]:
    """Return targets for detection: the new models must find as many faults as the old ones.

    The verification puts faults on drives. An old model that takes the gap for a fault reports a
    fault on every drive; the share named right allows for this.
    """
    found = []
    where = "new models, rightly named; wanted is what the old ones do"
    for what, key, after, before, side in (
        ("faults put on and found", "faults", "after", "before", "least"),
        ("faults put on and named right", "faults", "after_named", "before_named", "least"),
        ("false alarms", "alarms", "after", "before", "most"),
    ):
        counts = [r[key] for r in rows if r[key] and {after, before} <= set(r[key])]
        drives, new, old = (sum(c[part] for c in counts) for part in ("drives", after, before))
        wanted = {side: old / drives if drives else 0.0}
        found.append(targets.share(what, where, rate(new, drives), **wanted))
    return found
