"""Tables of the catalyst matrix: verdicts, estimates, names, false alarms, rules of the field.

A catalyst up to ``LOW_G`` must be found, one from ``SOUND_G`` on must not be called; one between is
neither. A fault counts once its test's debounce counter has matured.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.studies.behind.cases import MODES
from benchmarks.studies.behind.rules import TITLES
from benchmarks.studies.sensor.conditions import AMBIENTS
from training.limits.rates import Figures, median, per_1000_h, rate, roc

Row = Mapping[str, Any]
Group = tuple[str, list[Row]]

LOW_G, SOUND_G, ESTIMATED_G = 0.06, 0.25, 0.1
TAIL_90: Final = 1.645  # standard deviations to either end of a 90 % interval
NEAR: Final = 0.2  # relative error of the capacity that is asked for
BALANCES: Final = {"biased_lean": "balance_rich", "biased_rich": "balance_lean"}


def result(rows: Sequence[Row], limits: Mapping[str, float | None]) -> Figures:
    """Return every table.

    limits : of the rules
    """
    main, wrong, second = (of_kind(rows, kind) for kind in ("main", "wrong", "second"))
    groups = grouped(main, wrong, second)
    return {
        "drives": {
            "all": len(rows),
            "main": len(main),
            "wrong": len(wrong),
            "second": len(second),
            "hours": sum(r["driving_s"] for r in rows) / 3600.0,
        },
        "verdicts": [{"drives": title, **verdicts(own)} for title, own in groups],
        "capacities": [
            {"drives": title, **estimates(own)} for title, own in [*groups, *sized(main)]
        ],
        "offsets": [{"drives": title, **offsets(own)} for title, own in groups],
        "false_alarms": false_alarms([*main, *wrong]),
        "names": {"first": names([*main, *wrong]), "second": names(second)},
        "rules": [rule_figures(main, rule, limits[rule]) for rule in TITLES],
    }


def of_kind(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return the rows of one kind: ``main``, ``wrong`` or ``second``."""
    return [r for r in rows if r["kind"] == kind]


def grouped(main: list[Row], wrong: list[Row], second: list[Row]) -> list[Group]:
    """Return groups of drives with their titles."""
    titles = {"passive": "no fuel cut", "cut": "fuel cuts", "active": "fuel cuts, active steps"}
    chosen: list[tuple[str, Callable[[Row], bool]]] = [
        ("all main drives", lambda r: True),
        ("no other fault", lambda r: not r["sensor"] and not r["upstream"]),
        *((titles[mode], lambda r, m=mode: r["mode"] == m) for mode in MODES),
        *((f"weather: {each}", lambda r, a=each: r["ambient"] == a) for each in AMBIENTS),
        ("ethanol below 5 %", lambda r: r["ethanol"] < 5.0),
        ("ethanol 5 to 10 %", lambda r: r["ethanol"] >= 5.0),
        ("aged downstream sensor", lambda r: bool(r["sensor"])),
        ("upstream offset of 0.02", lambda r: bool(r["upstream"])),
    ]
    found = [(title, [r for r in main if holds(r)]) for title, holds in chosen]
    found += [("meter, injector or fuel wrong", wrong), ("second engine", second)]
    return [group for group in found if group[1]]


def sized(rows: Sequence[Row]) -> list[Group]:
    """Return groups by capacity; the vehicle's own ones are one group."""
    sizes = sorted({r["grams"] for r in rows}, key=lambda g: g or np.inf)
    return [
        (f"{g:g} g" if g else "the vehicle's own", [r for r in rows if r["grams"] == g])
        for g in sizes
    ]


def verdicts(rows: Sequence[Row]) -> Figures:
    """Return how the catalysts were judged."""
    low = [r for r in rows if r["true_g"] <= LOW_G]
    sound = [r for r in rows if r["true_g"] >= SOUND_G]
    return {
        "found": rate(sum(map(failed, low)), len(low)),
        "false_pass": rate(sum(map(passed, low)), len(low)),
        "false": rate(sum(map(failed, sound)), len(sound)),
        "passed": rate(sum(map(passed, sound)), len(sound)),
        "decided_s": median([r["decided_s"] for r in (*low, *sound)]),
    }


def failed(row: Row) -> bool:
    """Return whether the catalyst was called low."""
    return "catalyst" in row["faults"]


def passed(row: Row) -> bool:
    """Return whether the catalyst ever passed."""
    return "catalyst" in row["passed_s"]


def estimates(rows: Sequence[Row]) -> Figures:
    """Return bias, spread and coverage of the capacity; a lower bound is no estimate.

    bias : mean logarithm of estimate over truth, as a relative error; spread : its standard
    deviation; near : share within 20 %; covered : by the 90 % interval, lower bounds too
    """
    own = [r for r in rows if r["true_g"] >= ESTIMATED_G and r.get("capacity_g")]
    told = [r for r in own if not r["capacity_is_bound"]]
    error = np.log([r["capacity_g"] / r["true_g"] for r in told])
    near = np.abs(np.expm1(error)) <= NEAR
    return {
        "drives_estimated": len(told),
        "bounds": len(own) - len(told),
        "bias": float(np.expm1(error.mean())) if told else None,
        "spread": float(error.std()) if told else None,
        "near": rate(int(near.sum()), len(told)),
        "covered": rate(sum(map(_covers, own)), len(own)),
    }


def _covers(row: Row) -> bool:
    high = row["capacity_high_g"]
    return bool(row["capacity_low_g"] <= row["true_g"] <= (np.inf if high is None else high))


def offsets(rows: Sequence[Row]) -> Figures:
    """Return what was said of upstream and downstream sensor."""
    biased = [r for r in rows if r["upstream"]]
    straight = [r for r in rows if not r["upstream"] and not r["leak"]]
    aged, sound = ([r for r in rows if bool(r["sensor"]) is is_aged] for is_aged in (True, False))
    judged = [r for r in rows if r.get("segments")]
    error = np.array([r["upstream_offset_lambda"] - r["offset_lambda"] for r in judged])
    std = np.array([r["upstream_offset_std"] for r in judged])
    return {
        "named": rate(sum(_is_balanced_rightly(r) for r in biased), len(biased)),
        "called": rate(sum("balance" in r["faults"] for r in straight), len(straight)),
        "bias": float(error.mean()) if judged else None,
        "spread": float(error.std()) if judged else None,
        "std": float(np.median(std)) if judged else None,
        "covered": rate(int((np.abs(error) <= TAIL_90 * std).sum()), len(judged)),
        "aged_named": rate(sum("downstream" in r["faults"] for r in aged), len(aged)),
        "sound_called": rate(sum("downstream" in r["faults"] for r in sound), len(sound)),
    }


def _is_balanced_rightly(row: Row) -> bool:
    return bool(row["faults"].get("balance") == BALANCES[row["upstream"]])


def false_alarms(rows: Sequence[Row]) -> Figures:
    """Return drives with a code although nothing behind the engine is faulty, per 1,000 h."""
    good = [r for r in rows if truth(r) == "sound"]
    events = [r for r in good if r["faults"]]
    return {
        "false": rate(len(events), len(good)),
        "per_1000_h": per_1000_h(len(events), sum(r["driving_s"] for r in good)),
        "drives": [{k: r[k] for k in ("number", "vehicle", "true_g", "faults")} for r in events],
    }


def truth(row: Row) -> str:
    """Return the drive's faults as the name of its condition."""
    grams = row["true_g"]
    size = "catalyst_low" if grams <= LOW_G else "between" if grams < SOUND_G else ""
    balance = BALANCES.get(row["upstream"], "balance_lean" if row["leak"] else "")
    return " + ".join(each for each in (size, row["sensor"], balance) if each) or "sound"


def names(rows: Sequence[Row]) -> list[Figures]:
    """Return how often each condition got which names, the most frequent first."""
    given = Counter((truth(r), " + ".join(sorted(r["faults"].values())) or "none") for r in rows)
    return [{"driven": a, "named": b, "drives": n} for (a, b), n in sorted(given.items())]


def rule_figures(rows: Sequence[Row], rule: str, limit: float | None) -> Figures:
    """Return what a rule of the field says of the same drives; nothing without a limit."""
    low = [r["rules"][rule] for r in rows if r["true_g"] <= LOW_G]
    sound = [r["rules"][rule] for r in rows if r["true_g"] >= SOUND_G]
    told = [[x for x in each if x is not None] for each in (low, sound)]
    n_found, n_false = (sum(limit is not None and x > limit for x in each) for each in told)
    n_low, n_sound = (len(each) if limit is not None else 0 for each in told)
    return {
        "rule": rule,
        "limit": limit,
        "found": rate(n_found, n_low),
        "false": rate(n_false, n_sound),
        "area": roc(told[1], told[0])["area"],
        "nothing": len(low) + len(sound) - len(told[0]) - len(told[1]),
    }
