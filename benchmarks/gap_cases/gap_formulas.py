"""Effects outside the library: how near does the formula come to a chain without the effect?

Cases are simulated: the three effects of the dynamometer that the library lacks, and effects that
are put on the mixture of the second engine as functions of its state. The set ``choose`` is for
choosing forms; ``report`` has other effects, vehicles and seeds. Drives last five minutes, four
(dynamometer) or six (second engine) per case, against eight healthy ones. Missing cases are made
first.

python -m benchmarks gap_formulas [--folder build/gap_formulas] [--set report] [--only TEXT]
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.gap_cases import stored
from benchmarks.gap_cases.answers import NEAR, Answer, ratio, share
from benchmarks.gap_cases.stored import SMALLEST, WHOLE, Made, Size, Stored, plain
from benchmarks.outcome import BenchmarkOptions, Row, finish
from benchmarks.studies.second.engine import STEP_S, Car, Outside
from benchmarks.studies.second.engine import drive as second_drive
from monitor.base.types import FloatArray
from training.gap.name.verdict import Naming
from training.greybox.effects.empirical import formula
from training.greybox.fit.drive import ChainDrive
from training.greybox.quantity.dynamics import lag

Form = Callable[[Car, FloatArray], FloatArray]  # of car and time in s


class MixtureEffect(NamedTuple):
    """What is put on the second engine: a change of the mixture, or fuel."""

    percent: Form | None = None  # of the mixture
    vapour_mg_s: Form | None = None  # of fuel


def flow_kg_h(car: Car) -> FloatArray:
    """Return the air flow of the engine, (n,)."""
    return np.asarray(np.maximum(car.air_mg * car.rpm / 30.0 * 3600e-6, 3.0))


CHOOSE: Final[dict[str, MixtureEffect]] = {
    "flap over speed": MixtureEffect(lambda c, _: -4.0 / (1.0 + np.exp((c.rpm - 2000.0) / 60.0))),
    "breather by vacuum": MixtureEffect(
        vapour_mg_s=lambda c, _: 0.35 * np.maximum(98.0 - c.manifold_kpa, 0.0)
    ),
    "fuel behind flow": MixtureEffect(lambda c, _: -0.05 * lag(flow_kg_h(c), 30.0, STEP_S)),
    "residual gas": MixtureEffect(lambda c, _: 6.0 * c.manifold_kpa / 100.0 * c.rpm / 2000.0),
}
REPORT: Final[dict[str, MixtureEffect]] = {
    "exhaust gas by vacuum": MixtureEffect(
        lambda c, _: 4.0 * (100.0 - c.manifold_kpa) / c.manifold_kpa
    ),
    "island of the cams": MixtureEffect(
        lambda c, _: (
            6.0 * np.exp(-(((c.rpm - 1900.0) / 500.0) ** 2) - ((c.manifold_kpa - 70.0) / 20.0) ** 2)
        )
    ),
    "short pulses": MixtureEffect(lambda c, _: -10.0 * np.exp(-(c.air_mg - 80.0) / 70.0)),
    "port that cools in cuts": MixtureEffect(lambda c, _: -8.0 * lag(c.cut, 8.0, STEP_S)),
    "pump that warms up": MixtureEffect(lambda _, t_s: -7.0 * np.exp(-t_s / 100.0)),
    "bypass of the idle": MixtureEffect(lambda c, _: 6.0 / (1.0 + np.exp((c.rpm - 1000.0) / 40.0))),
    "hot intake": MixtureEffect(lambda c, _: 0.5 * (c.intake_degc - 25.0)),
}
# effects and vehicles of the second engine; first vehicle and cases of the dynamometer
SETS: Final = {
    "choose": (CHOOSE, (33, 34), (52_000, 18)),
    "report": (REPORT, (86_059, 86_060), (86_104, 8)),
}
SMALLER: Final = 0.5  # of an effect's size, in the second vehicle
ONE_CASE: Final = "case_second_33_000"  # of the set choose


def main(argv: Sequence[str]) -> int:
    """Make the cases that are missing, and answer them."""
    options = BenchmarkOptions(__name__, __doc__, set="choose", only=ONE_CASE, folder=None)
    options.add_argument("--folder", type=Path, default=Path("build/gap_formulas"))
    options.add_argument("--set", choices=tuple(SETS), default="report")
    options.add_argument("--only", default="", help="part of the keys of the cases")
    args = options.parse_args(argv)
    with stored.place(args.folder) as place:
        folder = place / args.set
        size = SMALLEST if args.smallest else WHOLE
        first, number = SETS[args.set][2]
        study = stored.dyno_study(first, 4, [("unknown", number)], size)
        made = chain(stored.dyno_made(study), _of_second(args.set, size))
        stored.make(folder, made, args.only)
        found = [_row(*each) for each in stored.answers(folder, args.only, lambda _: 1)]
    shares: list[Row] = []
    for least in (2.0, 1.0, 0.0):
        asked = [row for row in found if row["gap : noise"] >= least]
        near = [(row["after : without"] or np.inf) <= NEAR for row in asked]
        if near:
            words = f"within {NEAR - 1:.0%}, gap of {least:g} times the noise"
            shares.append(share(words, sum(near), len(near)))
    return finish(args, [*found, *shares])


def _row(answer: Answer, naming: Naming) -> dict[str, Any]:
    found = [c for c in naming.answer.effects if c.kind == "empirical"]
    values = [own.tolist() for own in found[-1].fit.parameters] if found else []
    after = naming.error.after if found else None
    names = [c.name for c in naming.answer.effects if c.kind == "effect"]
    return {
        "case": answer["key"],
        "hidden": " ".join(answer["hidden"]),
        "gap : noise": ratio(answer),
        "verdict": " ".join((naming.verdict, *names)),
        "before": naming.error.before,
        "without": answer["without"],
        "after : without": after / answer["without"] if after else None,
        "formula": "; ".join(formula(c.name, v) for c, v in zip(found, values, strict=True)),
    }


def _of_second(set_: str, size: Size) -> Made:
    effects, vehicles, _ = SETS[set_]
    for place, vehicle in enumerate(vehicles):
        yield (
            f"second_{vehicle}",
            lambda v=vehicle: plain(
                second_drive(v, 1000 * v + i, length_s=size.length_s) for i in range(size.healthy)
            ),
        )
        scale = SMALLER if place % 2 else 1.0
        for number, (what, effect) in enumerate(effects.items()):
            key = f"case_second_{vehicle}_{number:03d}"
            yield key, partial(_second, key, vehicle, number, what, effect, scale, size)


def _second(
    key: str,
    vehicle: int,
    number: int,
    what: str,
    effect: MixtureEffect,
    scale: float,
    size: Size,
) -> Stored:
    def outside(car: Car) -> Outside:
        t_s = np.arange(len(car.rpm)) * STEP_S
        percent, vapour = (
            scale * form(car, t_s) if form else np.zeros(len(t_s)) for form in effect
        )
        return Outside(1.0 + percent / 100.0, vapour)

    def driven(hidden: Callable[[Car], Outside] | None) -> list[ChainDrive]:
        seeds = [1000 * vehicle + 100 + 10 * number + i for i in range(size.case)]
        return plain(
            second_drive(vehicle, seed, length_s=size.length_s, outside=hidden) for seed in seeds
        )

    return Stored(
        key=key,
        vehicle=f"second_{vehicle}",
        kind="unknown",
        hidden=(what,),
        size=scale,
        drives=driven(outside),
        sound=driven(None),
    )
