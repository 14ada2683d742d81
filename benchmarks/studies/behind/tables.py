"""Tables and targets of the catalyst matrix: verdicts, estimates, names, false alarms, rules.

A catalyst up to ``LOW_G`` must be found, one from ``SOUND_G`` on must not be called; one between is
neither. A fault counts once its test's debounce counter has matured.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.studies import targets
from benchmarks.studies.behind.plan import FIRST_VEHICLE, LEARNING, MODES, CatalystMatrix
from benchmarks.studies.behind.rules import TITLES
from benchmarks.studies.behind.run import LIMITS
from benchmarks.studies.report import DEVELOPMENT, Report, Section
from benchmarks.studies.sensor.conditions import AMBIENTS
from benchmarks.studies.tables import AND, Row, answers, median, of_kind
from benchmarks.studies.targets import Target
from training.limits.rates import Figures, per_1000_h, rate

Group = tuple[str, list[Row]]

LOW_G, SOUND_G, ESTIMATED_G = 0.06, 0.25, 0.1
TAIL_90: Final = 1.645  # standard deviations to either end of a 90 % interval
NEAR: Final = 0.2  # relative error of the capacity that is asked for
BALANCES: Final = {"biased_lean": "balance_rich", "biased_rich": "balance_lean"}
FOUND, FALSE, FALSE_PASS, NAMED = 0.99, 0.01, 0.02, 0.95
SPREAD: Final = 0.2  # one standard deviation of the capacity
COVERED: Final = (0.88, 0.92)
DECIDED_S: Final = 600.0
KINDS: Final = {
    "main": "main",
    "wrong": "with wrong metering or fuel",
    "second": "of a second engine",
}


def report(matrix: CatalystMatrix, rows: Sequence[Row]) -> Report:
    """Return the report of a run."""
    limits: Mapping[str, Any] = next(iter(of_kind(rows, LIMITS)), {})
    main, wrong, second = (of_kind(rows, kind) for kind in KINDS)
    driven = [*main, *wrong, *second]
    counts = ", ".join(f"{len(of_kind(rows, kind))} {title}" for kind, title in KINDS.items())
    about = [
        f"behind the catalyst: {len(driven)} simulated drives, "
        f"{sum(r['driving_s'] for r in driven) / 3600.0:.0f} h: {counts}",
        f"A drive has {matrix.seconds:g} s and a vehicle, driver and noise of its own (vehicles "
        f"from {matrix.first_vehicle}). Main drives have a drawn capacity, weather, fuel (E0 to "
        "E10) and evidence (no fuel cut; fuel cuts; fuel cuts and the ECU's active steps), three "
        "of ten an aged downstream sensor (slow by 1 s), two of five an upstream offset of 0.02. "
        "Others have an air meter or injectors wrong by 5 %, or a fuel that asks for 5 % more, and "
        "no fault. The second engine and its catalyst have other equations.",
    ]
    if matrix.first_vehicle < FIRST_VEHICLE:
        about.append(DEVELOPMENT)
    groups = grouped(main, wrong, second)
    sizes = [*groups, *sized(main)]
    low = f"Low: up to {LOW_G:g} g of oxygen. Sound: from {SOUND_G:g} g on."
    set_on = ", ".join(map(str, LEARNING))
    sections = [
        Section("Verdicts on the catalyst", [verdicts(own, title) for title, own in groups], low),
        Section("Estimate of the capacity", [estimates(own, title) for title, own in sizes]),
        Section("Upstream and downstream sensor", [offsets(own, title) for title, own in groups]),
        Section("Drives with a code and no fault", false_alarms([*main, *wrong])),
        Section("Names given, dynamometer", names([*main, *wrong])),
        Section("Names given, second engine", names(second)),
        Section(
            "Rules of the field on the same drives",
            [rule_figures(main, rule, limits.get(rule)) for rule in TITLES],
            f"Each limit is the middle between 0.06 g and 0.25 g on vehicles {set_on}.",
        ),
    ]
    title = "Simulated drives with a catalyst"
    return Report(title, about, assess(driven), sections if driven else ())


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


def verdicts(rows: Sequence[Row], title: str = "") -> Figures:
    """Return how the catalysts were judged."""
    low = [r for r in rows if r["true_g"] <= LOW_G]
    sound = [r for r in rows if r["true_g"] >= SOUND_G]
    return {
        "drives": title,
        "low found": rate(sum(map(failed, low)), len(low)),
        "low passed": rate(sum(map(passed, low)), len(low)),
        "sound called": rate(sum(map(failed, sound)), len(sound)),
        "sound passed": rate(sum(map(passed, sound)), len(sound)),
        "decided s": median([r["decided_s"] for r in (*low, *sound)]),
    }


def failed(row: Row) -> bool:
    """Return whether the catalyst was called low."""
    return "catalyst" in row["faults"]


def passed(row: Row) -> bool:
    """Return whether the catalyst ever passed."""
    return "catalyst" in row["passed_s"]


def estimates(rows: Sequence[Row], title: str = "") -> Figures:
    """Return bias, spread and coverage of the capacity; a lower bound is no estimate.

    bias : mean logarithm of estimate over truth, as a relative error; spread : its standard
    deviation; near : share within 20 %; covered : by the 90 % interval, lower bounds too
    """
    own = [r for r in rows if r["true_g"] >= ESTIMATED_G and r.get("capacity_g")]
    told = [r for r in own if not r["capacity_is_bound"]]
    error = np.log([r["capacity_g"] / r["true_g"] for r in told])
    near = np.abs(np.expm1(error)) <= NEAR
    return {
        "drives": title,
        "estimates": len(told),
        "lower bounds": len(own) - len(told),
        "bias": float(np.expm1(error.mean())) if told else None,
        "spread": float(error.std()) if told else None,
        "near": rate(int(near.sum()), len(told)),
        "covered": rate(sum(map(_covers, own)), len(own)),
    }


def _covers(row: Row) -> bool:
    high = row["capacity_high_g"]
    return bool(row["capacity_low_g"] <= row["true_g"] <= (np.inf if high is None else high))


def offsets(rows: Sequence[Row], title: str = "") -> Figures:
    """Return what was said of upstream and downstream sensor."""
    biased = [r for r in rows if r["upstream"]]
    straight = [r for r in rows if not r["upstream"] and not r["leak"]]
    aged, sound = ([r for r in rows if bool(r["sensor"]) is is_aged] for is_aged in (True, False))
    judged = [r for r in rows if r.get("segments")]
    error = np.array([r["upstream_offset_lambda"] - r["offset_lambda"] for r in judged])
    std = np.array([r["upstream_offset_std"] for r in judged])
    rightly = sum(r["faults"].get("balance") == BALANCES[r["upstream"]] for r in biased)
    return {
        "drives": title,
        "offset named": rate(rightly, len(biased)),
        "called without one": rate(sum("balance" in r["faults"] for r in straight), len(straight)),
        "bias": float(error.mean()) if judged else None,
        "spread": float(error.std()) if judged else None,
        "std": float(np.median(std)) if judged else None,
        "90 % covers": rate(int((np.abs(error) <= TAIL_90 * std).sum()), len(judged)),
        "aged one named": rate(sum("downstream" in r["faults"] for r in aged), len(aged)),
        "sound one called": rate(sum("downstream" in r["faults"] for r in sound), len(sound)),
    }


def false_alarms(rows: Sequence[Row]) -> list[Figures]:
    """Return drives with a code although nothing behind the engine is faulty, per 1,000 h."""
    good = [r for r in rows if truth(r) == "sound"]
    events = [r for r in good if r["faults"]]
    return [
        {
            "with a code": rate(len(events), len(good)),
            "per 1000 h": per_1000_h(len(events), sum(r["driving_s"] for r in good)),
            "drives": [r["number"] for r in events],
        }
    ]


def truth(row: Row) -> str:
    """Return the drive's faults as the name of its condition."""
    grams = row["true_g"]
    size = "catalyst_low" if grams <= LOW_G else "between" if grams < SOUND_G else ""
    balance = BALANCES.get(row["upstream"], "balance_lean" if row["leak"] else "")
    return AND.join(each for each in (size, row["sensor"], balance) if each) or "sound"


def names(rows: Sequence[Row]) -> list[Figures]:
    """Return how often each condition got which names."""
    return answers((truth(r), AND.join(sorted(r["faults"].values())) or "none") for r in rows)


def rule_figures(rows: Sequence[Row], rule: str, limit: float | None) -> Figures:
    """Return what a rule of the field says of the same drives; nothing without a limit."""
    low = [r["rules"][rule] for r in rows if r["true_g"] <= LOW_G]
    sound = [r["rules"][rule] for r in rows if r["true_g"] >= SOUND_G]
    told = [[x for x in each if x is not None] for each in (low, sound)]
    n_found, n_false = (sum(limit is not None and x > limit for x in each) for each in told)
    n_low, n_sound = (len(each) if limit is not None else 0 for each in told)
    return {
        "rule": TITLES[rule],
        "limit": limit,
        "found": rate(n_found, n_low),
        "false": rate(n_false, n_sound),
        "nothing to look at": len(low) + len(sound) - len(told[0]) - len(told[1]),
    }


def assess(rows: Sequence[Row]) -> list[Target]:
    """Return the targets in the order of the report."""
    main, wrong = of_kind(rows, "main"), of_kind(rows, "wrong")
    low = [r for r in rows if r["true_g"] == LOW_G]
    bad = [r for r in rows if r["true_g"] <= LOW_G and r["sensor"]]
    sound = [r for r in rows if r["true_g"] >= SOUND_G]
    capacity, said = estimates(main), offsets([*main, *of_kind(rows, "second")])
    called = rate(sum("balance" in r["faults"] for r in wrong), len(wrong))
    least, most = COVERED
    n = capacity["estimates"]
    spread = capacity["spread"]
    told = rate(sum(map(failed, low)), len(low)), rate(sum(map(failed, sound)), len(sound))
    pass_ = rate(sum(map(passed, bad)), len(bad))
    return [
        targets.share("found", f"{LOW_G:g} g", told[0], FOUND),
        targets.share("called low", f"{SOUND_G:g} g and more", told[1], most=FALSE),
        targets.share("passed", "bad catalyst behind a slow sensor", pass_, most=FALSE_PASS),
        Target("spread, from 0.1 g on", "capacity", "share", spread, trials=n, most=SPREAD),
        targets.share("within its 90 % interval", "capacity", capacity["covered"], least, most),
        targets.share("named within a drive", "offset of 0.02", said["offset named"], NAMED),
        targets.share("upstream sensor called", "wrong by 5 %", called, most=0.0),
        targets.time(
            "median time", "verdict on the catalyst", verdicts(main)["decided s"], DECIDED_S
        ),
    ]
