"""Effects outside the library: how near does the formula come to a chain without the effect?

Cases are simulated: the three effects of the dynamometer that the library lacks, and effects that
are put on the mixture of the second engine as functions of its state. The sets ``choose``,
``choose_more`` and ``choose_third`` are for choosing forms; ``report`` has other effects, vehicles
and seeds. Drives last five minutes, four (dynamometer) or six (second engine) per case, against
eight healthy ones. Set ``choose_third`` has effects of the library and nulls, too: is a formula
taken for one of them?

    python -m benchmarks gap_formulas make FOLDER [--set report]
    python -m benchmarks gap_formulas answer FOLDER [--set report]
"""

import argparse
import pickle
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from benchmarks.gap_cases import gap_naming
from benchmarks.gap_cases.gap_naming import HEALTHY_DRIVES, LENGTH_S, Stored
from benchmarks.studies.second.engine import STEP_S, Car, Outside
from benchmarks.studies.second.engine import drive as second_drive
from benchmarks.studies.workflow import drive as dyno
from benchmarks.studies.workflow import plan
from monitor.base.types import FloatArray
from training.gap.healthy.behaviour import Healthy
from training.gap.name.naming import name
from training.gap.name.verdict import Candidate
from training.gap.response.regressors import lagged
from training.greybox.effects.empirical import formula
from training.greybox.fit.drive import Drive, from_recording

Form = Callable[[Car, FloatArray], FloatArray]  # of car and time in s
NEAR: Final = 1.1  # times the error without the effect
DRIVES: Final = 6


class Effect(NamedTuple):
    """What is put on the second engine: a change of the mixture, or fuel."""

    percent: Form | None = None  # of the mixture
    vapour_mg_s: Form | None = None  # of fuel


def flow_kg_h(car: Car) -> FloatArray:
    """Return the air flow of the engine, (n,)."""
    return np.asarray(np.maximum(car.air_mg * car.rpm / 30.0 * 3600e-6, 3.0))


CHOOSE: Final[dict[str, Effect]] = {
    "flap over speed": Effect(lambda c, _: -4.0 / (1.0 + np.exp((c.rpm - 2000.0) / 60.0))),
    "breather by vacuum": Effect(
        vapour_mg_s=lambda c, _: 0.35 * np.maximum(98.0 - c.manifold_kpa, 0.0)
    ),
    "fuel behind flow": Effect(lambda c, _: -0.05 * lagged(flow_kg_h(c), 30.0, STEP_S)),
    "residual gas": Effect(lambda c, _: 6.0 * c.manifold_kpa / 100.0 * c.rpm / 2000.0),
}
CHOOSE_MORE: Final[dict[str, Effect]] = {
    "hinge over pressure": Effect(
        lambda c, _: -8.0 * np.maximum(c.manifold_kpa - 55.0, 0.0) / 50.0
    ),
    "resonance under load": Effect(
        lambda c, _: 5.0 * np.exp(-(((c.rpm - 2300.0) / 220.0) ** 2)) * c.manifold_kpa / 60.0
    ),
    "pump droop": Effect(lambda c, _: -6.0 * (flow_kg_h(c) / 100.0) ** 1.5),
    "cold injector": Effect(lambda c, _: 12.0 * np.exp(-(c.coolant_degc - 20.0) / 25.0)),
    "wall of the port": Effect(lambda c, _: 0.12 * lagged(c.manifold_kpa, 12.0, STEP_S)),
    "fuel from a seep": Effect(vapour_mg_s=lambda c, _: np.full(len(c.rpm), 14.0)),
    "vapour that fades": Effect(vapour_mg_s=lambda _, t_s: 40.0 * np.exp(-t_s / 150.0)),
}
CHOOSE_THIRD: Final[dict[str, Effect]] = {
    "hot fuel at low flow": Effect(
        lambda c, _: -0.25 * np.maximum(c.coolant_degc - 40.0, 0.0) * np.exp(-flow_kg_h(c) / 40.0)
    ),
    "valve lift under load": Effect(
        lambda c, _: 5.0 / (1.0 + np.exp((2400.0 - c.rpm) / 80.0)) * c.manifold_kpa / 70.0
    ),
    "leak past the throttle": Effect(
        lambda c, _: -60.0 * np.sqrt(np.maximum(1.0 - c.manifold_kpa / 100.0, 0.0)) / flow_kg_h(c)
    ),
    "hinge over flow": Effect(lambda c, _: -9.0 * np.maximum(flow_kg_h(c) - 70.0, 0.0) / 60.0),
    "gas over pressure": Effect(
        lambda c, _: 6.0 * np.exp(-(((c.manifold_kpa - 70.0) / 14.0) ** 2))
    ),
    "walls behind speed": Effect(lambda c, _: 0.004 * lagged(c.rpm - 1500.0, 20.0, STEP_S)),
    "vapour of a warm engine": Effect(
        vapour_mg_s=lambda c, _: 20.0 * np.exp((c.coolant_degc - 90.0) / 15.0)
    ),
}
REPORT: Final[dict[str, Effect]] = {
    "exhaust gas by vacuum": Effect(lambda c, _: 4.0 * (100.0 - c.manifold_kpa) / c.manifold_kpa),
    "island of the cams": Effect(
        lambda c, _: (
            6.0 * np.exp(-(((c.rpm - 1900.0) / 500.0) ** 2) - ((c.manifold_kpa - 70.0) / 20.0) ** 2)
        )
    ),
    "short pulses": Effect(lambda c, _: -10.0 * np.exp(-(c.air_mg - 80.0) / 70.0)),
    "port that cools in cuts": Effect(lambda c, _: -8.0 * lagged(c.cut, 8.0, STEP_S)),
    "pump that warms up": Effect(lambda _, t_s: -7.0 * np.exp(-t_s / 100.0)),
    "bypass of the idle": Effect(lambda c, _: 6.0 / (1.0 + np.exp((c.rpm - 1000.0) / 40.0))),
    "hot intake": Effect(lambda c, _: 0.5 * (c.intake_degc - 25.0)),
}
# effects and vehicles of the second engine; first vehicle and cases of the dynamometer
SETS: Final = {
    "choose": (CHOOSE, (33, 34), (52_000, {"unknown": 18})),
    "choose_more": (CHOOSE_MORE, (57, 58), (57_000, {"unknown": 12})),
    "choose_third": (
        CHOOSE_THIRD,
        (86_057, 86_058),
        (86_100, {"unknown": 12, "effect": 16, "null": 12}),
    ),
    "report": (REPORT, (86_059, 86_060), (86_104, {"unknown": 8})),
}
SMALLER: Final = 0.5  # of an effect's size, in the second vehicle


def main(argv: Sequence[str]) -> int:
    """Make the cases, or answer them and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", choices=("make", "answer"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--set", choices=tuple(SETS), default="report")
    parser.add_argument("--only", default="", help="part of the keys of the cases")
    args = parser.parse_args(argv)
    folder = args.folder / args.set
    folder.mkdir(parents=True, exist_ok=True)
    if args.part == "make":
        for key, made in (*_of_dyno(args.set), *_of_second(args.set)):
            path = folder / f"{key}.pickle"
            if args.only in key and not path.exists():
                path.write_bytes(pickle.dumps(made()))
        return None
    with threadpool_limits(1):
        _answer(folder, args.only)
    return 0


def _answer(folder: Path, only: str) -> None:
    rows = []
    print("| case | gap / noise | verdict | before | with the formula | without the effect |")
    print("|---|---|---|---|---|---|")
    for path in sorted(folder.glob("case_*.pickle")):
        if only in path.stem:
            case: Stored = pickle.loads(path.read_bytes())
            known = gap_naming._learned(folder / f"{case.vehicle}.pickle")
            rows.append(_row(case, known))
    for least in (2.0, 1.0, 0.0):
        of = [each for each in rows if each.kind == "unknown" and each.ratio >= least]
        near = sum(each.near for each in of)
        low, high = stats.binomtest(near, len(of)).proportion_ci(method="exact")
        share = f"{near} of {len(of)} ({low:.1%} to {high:.1%})"
        print(f"gap of at least {least:g} times the noise: {share} within {NEAR - 1:.0%}")
    for kind, count in Counter((each.kind, each.said) for each in rows).most_common():
        print(f"{count:3d} {kind[0]}: {kind[1]}")


class Row(NamedTuple):
    """One answer."""

    kind: str
    ratio: float  # gap over noise
    said: str  # verdict, right or wrong name
    near: bool  # the formula's error to that without the effect


def _row(case: Stored, known: Healthy) -> Row:
    """Print a row of the table and return it."""
    naming = name(case.drives, known)
    moved_by = [gap_naming._errors(drives, known) for drives in (case.drives, case.sound)]
    moved = np.concatenate([a - b for a, b in zip(*moved_by, strict=True)])
    sound = float(np.sqrt(np.nanmean(np.concatenate(moved_by[1]) ** 2)))
    found = [c for c in naming.answer.effects if c.kind == "empirical"]
    after = naming.error.after if found else None
    ratio = float(np.sqrt(np.nanmean(moved**2))) / naming.error.floor
    terms = "; ".join(formula(c.name, v) for c, v in zip(found, _values(found), strict=True))
    names = [c.name for c in naming.answer.effects if c.kind == "effect"]
    said = naming.verdict
    if said == "named":
        said = f"{'right' if set(names) <= set(case.hidden) else 'wrong'} name"
    print(
        f"| {case.key[5:]} {' '.join(case.hidden)} | {ratio:.1f} | {said} {' '.join(names)} "
        f"| {naming.error.before:.4f} | {'' if after is None else f'{after:.4f}'} {terms} "
        f"| {sound:.4f} |",
        flush=True,
    )
    return Row(case.kind, ratio, said, after is not None and after <= NEAR * sound)


def _values(found: Sequence[Candidate]) -> list[list[float]]:
    """Return the constants of all terms, of the fit of the last one."""
    return [own.tolist() for own in found[-1].fit.parameters] if found else []


def _of_dyno(set_: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    first, numbers = SETS[set_][2]
    study = plan.Study(
        cases=tuple(numbers.items()),
        vehicles=4,
        first_vehicle=first,
        seed=1000 * first,
        drives=gap_naming.DYNO_DRIVES,
        duration_s=LENGTH_S,
    )
    for vehicle in range(first, first + 4):
        parts = plan.healthy_parts(study, vehicle)
        yield (
            f"dyno_{vehicle}",
            lambda v=vehicle, p=parts: gap_naming._plain(
                map(from_recording, dyno.healthy(p, v, LENGTH_S))
            ),
        )
    for case in plan.cases(study):
        key = f"case_dyno_{case.number:03d}"
        yield key, lambda k=key, c=case: gap_naming._dyno_case(k, c)


def _of_second(set_: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    effects, vehicles, _ = SETS[set_]
    for place, vehicle in enumerate(vehicles):
        yield (
            f"second_{vehicle}",
            lambda v=vehicle: gap_naming._plain(
                second_drive(v, 1000 * v + i, length_s=LENGTH_S) for i in range(HEALTHY_DRIVES)
            ),
        )
        for number, (what, effect) in enumerate(effects.items()):
            size = SMALLER if place % 2 else 1.0
            key = f"case_second_{vehicle}_{number:03d}"
            yield (
                key,
                lambda k=key, v=vehicle, n=number, w=what, e=effect, s=size: _second(
                    k, v, n, w, e, s
                ),
            )


def _second(key: str, vehicle: int, number: int, what: str, effect: Effect, size: float) -> Stored:
    def outside(car: Car) -> Outside:
        t_s = np.arange(len(car.rpm)) * STEP_S
        percent, vapour = (size * form(car, t_s) if form else np.zeros(len(t_s)) for form in effect)
        return Outside(1.0 + percent / 100.0, vapour)

    def driven(hidden: Callable[[Car], Outside] | None) -> list[Drive]:
        seeds = [1000 * vehicle + 100 + 10 * number + i for i in range(DRIVES)]
        return gap_naming._plain(
            second_drive(vehicle, seed, length_s=LENGTH_S, outside=hidden) for seed in seeds
        )

    return Stored(
        key=key,
        vehicle=f"second_{vehicle}",
        kind="unknown",
        hidden=(what,),
        size=size,
        drives=driven(outside),
        sound=driven(None),
    )
