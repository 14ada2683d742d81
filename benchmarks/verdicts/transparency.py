"""The part of a sensor fault that reaches the prediction, and the cost of keeping it out.

lambda_controller is computed from the measured lambda, so a network can invert the controller and
predict the faulty reading. Four models are measured on simulated WLTCs: the shipped one (trained
with noise on the controller), and three trained with a smaller budget on the drives of
``make model``: seven inputs with noise, seven inputs without, six inputs without the controller.

Every drive and fault has four simulations, so that the true readings are known exactly:

- healthy, then replayed with its controller on a faulty sensor (``forced_trim``). The mixture is
  the same, so the readings differ by the fault alone. The model gets the healthy drive with the
  controller of the faulty one and all other inputs unchanged. ``share`` is the RMS of the
  prediction's change over that of the fault, ``gain`` its slope on the fault: at 0 the prediction
  ignores the fault, at 1 it follows it.
- faulty in the loop, then replayed with its controller on a healthy sensor, which gives the right
  reading. ``in the loop`` is the slope, on the fault, of the error that the fault adds to the
  prediction through all inputs: 1 hides the fault.

The limits of the shipped model are its own. Those of the others are set by ``o2train calibrate`` on
``--calibration`` if given, otherwise by their fits.

    python -m benchmarks transparency FOLDER --training build/training
        [--calibration build/calibration] [--budget 3] [--vehicles 4]

FOLDER keeps the models; existing models are not trained again.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from monitor.base import config, faults
from monitor.base.signals import NARX_INPUTS
from monitor.base.types import BoolArray, FloatArray, SampleBlock
from monitor.judge.limits import Limits
from monitor.model.step import Model, to_model_units
from monitor.pipeline.replay import shipped_model
from monitor.pipeline.side_by_side import Judged, judge_all
from training import cli
from training.dyno import ecu
from training.dyno.simulation import Experiment, simulate
from training.recordings import augmentation
from training.recordings.metrics import rmse

FAULTS = (
    ("slow_symmetric", 0.6),
    ("slow_rich_to_lean", 0.6),
    ("delay_symmetric", 0.6),
    ("gain_low", 0.5),
    ("biased_lean", 0.1),
)
CONTROLLER = augmentation.CONTROLLER
SIX = tuple(name for name in NARX_INPUTS if name != CONTROLLER)
TRAINED = {
    "seven, blurred": (NARX_INPUTS, augmentation.CONTROLLER_NOISE),
    "seven, exact": (NARX_INPUTS, 0.0),
    "six": (SIX, 0.0),
}
FIRST_VEHICLE, FIRST_SEED = 2000, 2_310_000  # of the development range
TRAINING_VEHICLE = 1
PERIOD_NS = 100_000_000
BUS = ecu.own_bus()


@dataclass(frozen=True, slots=True)
class Case:
    """One fault on one drive."""

    fault: str
    severity: float
    healthy: int  # place of its drive among the blocks
    mixed: int  # healthy drive with the controller of the faulty one
    faulty: int  # fault in the loop
    fault_alone: FloatArray  # (n,) phi, readings of the faulty sensor on the healthy mixture
    true_in_loop: FloatArray  # (n,) phi, what a healthy sensor reads of the faulty drive


def grid(signals: dict[str, FloatArray], experiment: Experiment) -> SampleBlock:
    """Return a drive as the bus brings it, on the sample grid."""
    rng = np.random.default_rng([0x0_2, 5, experiment.seed, experiment.vehicle])
    return ecu.samples(ecu.broadcast(signals, BUS, rng), BUS, PERIOD_NS)


def phi(block: SampleBlock) -> FloatArray:
    """Return the reading in phi, (n,)."""
    return to_model_units("phi", block.values[:, BUS.names.index("lambda_measured")])


def drive(experiment: Experiment, blocks: list[SampleBlock]) -> list[Case]:
    """Simulate a drive with every fault; add what is to be judged to ``blocks``."""
    sound = simulate(experiment)
    healthy = len(blocks)
    blocks.append(grid(sound, experiment))
    controller = BUS.names.index(CONTROLLER)
    found = []
    for name, severity in FAULTS:
        sick = replace(experiment, fault=faults.resolve(name, severity))
        in_loop = simulate(sick)
        alone = simulate(replace(sick, forced_trim=sound[CONTROLLER]))
        true = simulate(replace(experiment, forced_trim=in_loop[CONTROLLER]))
        faulty = grid(in_loop, experiment)
        values = blocks[healthy].values.copy()
        values[:, controller] = faulty.values[:, controller]
        at = len(blocks)
        blocks += [replace_values(blocks[healthy], values), faulty]
        found.append(
            Case(
                fault=name,
                severity=severity,
                healthy=healthy,
                mixed=at,
                faulty=at + 1,
                fault_alone=phi(grid(alone, experiment)),
                true_in_loop=phi(grid(true, experiment)),
            )
        )
    return found


def replace_values(block: SampleBlock, values: FloatArray) -> SampleBlock:
    """Return the block with other values."""
    return SampleBlock(block.index, block.t_ns, values, block.quality)


def slope(y: FloatArray, x: FloatArray) -> float:
    """Return the least-squares slope through the origin."""
    return float(y @ x / (x @ x))


def reach(case: Case, blocks: Sequence[SampleBlock], judged: Sequence[Judged]) -> FloatArray:
    """Return share, gain and slope in the loop."""
    healthy, mixed, faulty = (judged[i] for i in (case.healthy, case.mixed, case.faulty))
    predicted = [to_model_units("phi", j.predicted) for j in (healthy, mixed, faulty)]
    change = case.fault_alone - phi(blocks[case.healthy])
    rows = usable(healthy.enabled & mixed.enabled, change, *predicted[:2])
    moved = (predicted[1] - predicted[0])[rows]
    share = float(np.sqrt(np.mean(moved**2) / np.mean(change[rows] ** 2)))
    in_loop = phi(blocks[case.faulty]) - case.true_in_loop
    added = (predicted[2] - case.true_in_loop) - (predicted[0] - phi(blocks[case.healthy]))
    both = usable(healthy.enabled & faulty.enabled, in_loop, added)
    return np.array([share, slope(moved, change[rows]), slope(added[both], in_loop[both])])


def usable(rows: BoolArray, *series: FloatArray) -> BoolArray:
    """Return the rows at which every series has a number."""
    return np.asarray(rows & np.isfinite(series).all(axis=0))


def free_run(judged: Judged) -> tuple[float, float]:
    """Return the RMSE on enabled samples of a drive, lambda and phi."""
    on = usable(judged.enabled, judged.measured, judged.predicted)
    a, b = judged.measured[on], judged.predicted[on]
    return rmse(a, b), rmse(1.0 / a, 1.0 / b)


def models(folder: Path, training: Path, calibration: Path | None, budget: str) -> dict[str, Path]:
    """Return every model's file; those that are not there are trained one after the other."""
    found = {"shipped": shipped_model()}
    for name, (inputs, noise) in TRAINED.items():
        path = found[name] = folder / f"{name.replace(', ', '_')}.onnx"
        if path.exists():
            continue
        augmentation.CONTROLLER_NOISE = noise
        drives = [str(p) for p in sorted(training.glob("*.parquet"))]
        shape = ["--lags", "5", "--hidden", "8", "8", "--budget", budget]
        if cli.main(["fit", *drives, "--inputs", *inputs, "--out", str(path), *shape]):
            raise SystemExit(f"no model {name}")
        if calibration:
            given = [
                argument
                for option in ("healthy", "faulty")
                for argument in (f"--{option}", *map(str, sorted((calibration / option).glob("*"))))
                if not argument.endswith(".json")
            ]
            cli.main(["calibrate", "--model", str(path), *given])
    return found


def report(
    found: dict[str, Path], cases: Sequence[Case], blocks: Sequence[SampleBlock], own: int
) -> None:
    """Print the tables."""
    settings = config.load()
    reached: dict[str, list[FloatArray]] = {}
    detected, errors = {}, []
    for name, path in found.items():
        model = Model.load(path)
        limits = Limits.from_card(model.card, settings, str(path))
        judged = judge_all(blocks, BUS.names, model, limits, settings)
        reached[name] = [reach(case, blocks, judged) for case in cases]
        detected[name] = outcomes(cases, judged)
        others = [free_run(judged[i]) for i in dict.fromkeys(c.healthy for c in cases)]
        errors.append((name, free_run(judged[own]), np.mean(others, axis=0)))
    kinds = ("share", "gain", "in the loop")
    for k, kind in enumerate(kinds):
        print(f"\n| {kind} | {' | '.join(found)} |\n|---|{'---|' * len(found)}")
        for fault, severity in FAULTS:
            rows = [i for i, case in enumerate(cases) if case.fault == fault]
            cells = [f"{np.mean([each[i][k] for i in rows]):.3f}" for each in reached.values()]
            print(f"| {fault} {severity:g} | {' | '.join(cells)} |")
    print("\n| model | RMSE lambda, training vehicle | RMSE phi | other vehicles, lambda | phi |")
    print("|---|---|---|---|---|")
    for name, a, b in errors:
        print(f"| {name} | {a[0]:.4f} | {a[1]:.4f} | {b[0]:.4f} | {b[1]:.4f} |")
    print(f"\n| found, median enabled s | {' | '.join(found)} |\n|---|{'---|' * len(found)}")
    for row in ("healthy", *(fault for fault, _ in FAULTS)):
        print(f"| {row} | {' | '.join(detected[name][row] for name in found)} |")


def enabled_s(judged: Judged, t_ns: int) -> float:
    """Return how long samples were enabled until then, s."""
    return float(judged.enabled[: t_ns // PERIOD_NS + 1].sum()) * PERIOD_NS / 1e9


def outcomes(cases: Sequence[Case], judged: Sequence[Judged]) -> dict[str, str]:
    """Return in words what was found with each fault, and on the healthy drives."""
    healthy = [judged[i] for i in dict.fromkeys(c.healthy for c in cases)]
    alarms = sum(bool(j.dtcs) for j in healthy)
    passed = sum(j.completed and not j.dtcs for j in healthy)
    found = {"healthy": f"{alarms} of {len(healthy)} alarmed, {passed} passed"}
    for fault, _ in FAULTS:
        each = [judged[c.faulty] for c in cases if c.fault == fault]
        named = sum({d.fault for d in j.dtcs} == {fault} for j in each)
        other = Counter(d.fault for j in each for d in j.dtcs if d.fault != fault)
        passed = sum(j.completed and not j.dtcs for j in each)
        words = [f"{named} of {len(each)} named", *(f"{n} {k}" for n, k in sorted(other.items()))]
        seconds = [enabled_s(j, min(d.t_ns for d in j.dtcs)) for j in each if j.dtcs]
        words += [f"{np.median(seconds):.0f} s"] * bool(seconds) + [f"{passed} passed"] * bool(
            passed
        )
        found[fault] = ", ".join(words)
    return found


def main(argv: Sequence[str]) -> int:
    """Train what is missing, simulate, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="keeps the models trained")
    parser.add_argument("--training", type=Path, default=Path("build/training"))
    parser.add_argument("--calibration", type=Path, help="holds healthy/ and faulty/")
    parser.add_argument("--budget", default="3", help="minutes of each training")
    parser.add_argument("--vehicles", type=int, default=4)
    args = parser.parse_args(argv)
    args.folder.mkdir(parents=True, exist_ok=True)
    found = models(args.folder, args.training, args.calibration, args.budget)
    blocks: list[SampleBlock] = []
    cases: list[Case] = []
    for i in range(args.vehicles):
        cases += drive(Experiment(vehicle=FIRST_VEHICLE + i, seed=FIRST_SEED + i), blocks)
    own = Experiment(vehicle=TRAINING_VEHICLE, seed=FIRST_SEED - 1)
    blocks.append(grid(simulate(own), own))
    report(found, cases, blocks, len(blocks) - 1)
    return 0
