"""Targets of the catalyst matrix: the wanted and the measured figure, with exact 95 % bounds."""

from collections.abc import Sequence
from typing import Final

from benchmarks.studies.behind.tables import (
    LOW_G,
    SOUND_G,
    Row,
    estimates,
    failed,
    of_kind,
    offsets,
    passed,
)
from training.limits.rates import Figures, median, rate

FOUND, FALSE, FALSE_PASS, NAMED = 0.99, 0.01, 0.02, 0.95
SPREAD: Final = 0.2  # one standard deviation of the capacity
COVERED: Final = (0.88, 0.92)
DECIDED_S: Final = 600.0


def assess(rows: Sequence[Row]) -> list[Figures]:
    """Return the targets in the order of the report.

    The keys are ``what``, ``wanted``, ``share`` (rate with bounds) or ``value``, ``trials``,
    ``met``, None without a drive, and ``proved``, None where no bound is given.
    """
    main, wrong = of_kind(rows, "main"), of_kind(rows, "wrong")
    low = [r for r in rows if r["true_g"] == LOW_G]
    bad = [r for r in rows if r["true_g"] <= LOW_G and r["sensor"]]
    sound = [r for r in rows if r["true_g"] >= SOUND_G]
    capacity, said, others = estimates(main), offsets([*main, *of_kind(rows, "second")]), wrong
    called = sum("balance" in r["faults"] for r in others)
    return [
        _share("0.06 g found", rate(sum(map(failed, low)), len(low)), FOUND, None),
        _share(
            "0.25 g and more called low", rate(sum(map(failed, sound)), len(sound)), None, FALSE
        ),
        _share(
            "bad catalyst passed behind a slow sensor",
            rate(sum(map(passed, bad)), len(bad)),
            None,
            FALSE_PASS,
        ),
        _value("spread of the capacity above 0.1 g", capacity["spread"], SPREAD, "share")
        | {"trials": capacity["drives_estimated"]},
        _share("capacity within its 90 % interval", capacity["covered"], *COVERED),
        _share("upstream offset of 0.02 named within a drive", said["named"], NAMED, None),
        _share(
            "upstream sensor called, meter, injector or fuel wrong by 5 %",
            rate(called, len(others)),
            None,
            0.0,
        ),
        _time([r["decided_s"] for r in main if r["true_g"] <= LOW_G or r["true_g"] >= SOUND_G]),
    ]


def _share(what: str, share: Figures, least: float | None, most: float | None) -> Figures:
    found = share["rate"]
    met = None if found is None else _within(found, found, least, most)
    proved = None if found is None else _within(share["low"], share["high"], least, most)
    sides = [f"{sign} {100.0 * x:g} %" for sign, x in (("≥", least), ("≤", most)) if x is not None]
    return {
        "what": what,
        "wanted": " and ".join(sides),
        "share": share,
        "value": None,
        "trials": share["trials"],
        "met": met,
        "proved": proved,
    }


def _within(low: float, high: float, least: float | None, most: float | None) -> bool:
    return (least is None or low >= least) and (most is None or high <= most)


def _value(what: str, value: float | None, most: float, unit: str) -> Figures:
    wanted = f"≤ {100.0 * most:g} %" if unit == "share" else f"≤ {most:g} s"
    met = None if value is None else value <= most
    return {
        "what": what,
        "wanted": wanted,
        "share": None,
        "value": value,
        "unit": unit,
        "met": met,
        "proved": None,
    }


def _time(times: Sequence[float | None]) -> Figures:
    found = median(times)
    return _value("median time to the catalyst's verdict", found["median"], DECIDED_S, "s") | {
        "trials": len(times),
        "met": bool(found["median"] is not None and found["median"] <= DECIDED_S)
        if times
        else None,
        "proved": found["high"] is not None and found["high"] <= DECIDED_S if times else None,
    }


def found_text(target: Figures) -> str:
    """Return a target's measured figure with its counts and bounds.

    >>> found_text({"share": rate(0, 20), "value": None})
    '0 of 20 [0.0, 16.8] %'
    """
    share = target["share"]
    if share is not None:
        if share["rate"] is None:
            return "no such drive"
        low, high = 100.0 * share["low"], 100.0 * share["high"]
        return f"{share['events']} of {share['trials']} [{low:.1f}, {high:.1f}] %"
    value = target["value"]
    if value is None:
        return "never"
    return f"{100.0 * value:.0f} %" if target["unit"] == "share" else f"{value:.0f} s"


def as_text(found: Figures) -> str:
    """Return drives and targets as the lines that the command prints."""
    n = found["drives"]
    lines = [
        f"behind the catalyst: {n['all']} simulated drives, {n['hours']:.0f} h: {n['main']} main, "
        f"{n['wrong']} with wrong metering or fuel, {n['second']} of a second engine"
    ]
    for each in found["targets"]:
        verdict = {True: "met", False: "missed", None: "not judged"}[each["met"]]
        lines.append(f"{each['what']}: {found_text(each)}, wanted {each['wanted']}: {verdict}")
    return "\n".join(lines)
