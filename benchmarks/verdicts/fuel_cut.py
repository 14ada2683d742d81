"""The test of the fuel-cut response on drives that neither trained the model nor set its limits.

simulated   healthy drives (aged sensors, all weathers, fuels from E0 to E10) and response faults at
            their limits in the control loop, shipped model
bosch       runs of the Bosch engine 1 that are left out, and faults put on them afterwards
            (``bosch_verdicts.py``), model of the other half of the runs
logs        each log of one vehicle, judged by a model of its other logs, and faults put on it
dead        simulated healthy drives as they are, and with a sensor that reads lambda 1 with noise
            of 0.003 from two fifths of the drive on, shipped model

    python -m benchmarks fuel_cut simulated FIRST_VEHICLE [--healthy N] [--faulty N] [--linear M]
    python -m benchmarks fuel_cut bosch FOLDER SPLIT [--budget MINUTES]
    python -m benchmarks fuel_cut logs FOLDER [--budget MINUTES]
    python -m benchmarks fuel_cut dead FIRST_VEHICLE [--healthy N]

A drive without a fuel cut of 1 s is not counted. Beside the verdict stand the codes of the response
test on the same drives, with the level in air as evidence and without it.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.studies.sensor.conditions import AMBIENTS, ageing, weather
from benchmarks.verdicts import bosch_verdicts
from benchmarks.verdicts.bosch import MASK
from monitor.base import config, faults
from monitor.base.fault_streams import SensorFault
from monitor.base.faults import Fault
from monitor.base.signals import OUTPUT
from monitor.base.types import SampleBlock
from monitor.judge.fuel_cut.response import FuelCutResponse
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from monitor.pipeline.side_by_side import Judged, judge_all
from training import cli
from training.dyno import ecu
from training.dyno.effects import from_severities
from training.dyno.simulation import Experiment, simulate
from training.limits.judging import judge_recordings
from training.recordings.recording import load

CONFIG: Final = config.load()
CYCLES: Final = ("wltc_3b", "udds", "us06", "micro_trips", "hwfet")
LIMITS_OF: Final = {"slow": 0.5, "delay": 0.4, "transient": 0.5, "gain": 0.6}  # s, s, s, gain
NAMES: Final = tuple(name for name, _ in bosch_verdicts.FAULTS)

Drive = tuple[str, Judged, Judged]  # fault, judged with and without the level


def table(drives: Sequence[Drive], limits: Limits, transform: str) -> None:
    """Print verdicts by fault."""
    print(
        "| | drives with cuts | failed | named | passed | not decided | codes | named | without "
        "the level: codes | named |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    for fault in dict.fromkeys(name for name, *_ in drives):
        own = [each for each in drives if each[0] == fault and each[1].fuel_cuts]
        tests = [_test(judged, limits, transform) for _, judged, _ in own]
        verdicts = Counter(test.verdict for test in tests)
        named = sum(test.faults == (fault,) for test in tests)
        codes = [{dtc.fault for dtc in each.dtcs} for _, *pair in own for each in pair]
        counts = [
            f"{sum(map(bool, part))} | {sum(part_ == {fault} for part_ in part)}"
            for part in (codes[::2], codes[1::2])
        ]
        print(
            f"| {fault or 'healthy'} | {len(own)} | {verdicts['failed']} | {named} | "
            f"{verdicts['passed']} | {verdicts['inconclusive']} | {' | '.join(counts)} |"
        )
    gains = [
        test.gain[0]
        for name, j, _ in drives
        if not name and (test := _test(j, limits, transform)).gain
    ]
    if gains:
        print(f"healthy gains by the level: {len(gains)}, {min(gains):.3f} to {max(gains):.3f}")


def _test(judged: Judged, limits: Limits, transform: str) -> FuelCutResponse:
    test = FuelCutResponse(CONFIG, limits.fuel_cut, transform)
    for cut in judged.fuel_cuts:
        test.add(cut)
    return test


def simulated(first: int, healthy: int, faulty: int, linear: Path | None) -> None:
    """Judge simulated drives, each of a vehicle of its own, ten at a time."""
    model = Model.load(linear or shipped_model())
    limits = Limits.from_card(model.card, CONFIG, str(model.path))
    plan: list[tuple[str, Fault]] = [("", ageing(first * 1000 + k)) for k in range(healthy)]
    for name in NAMES:
        plan += [(name, faults.resolve(name, LIMITS_OF[name.split("_")[0]]))] * faulty
    found: list[Drive] = []
    bus_map = ecu.own_bus()
    for begin in range(0, len(plan), 10):
        part = plan[begin : begin + 10]
        blocks = [
            _driven(first, begin + k, fault, model, is_linear=linear is not None)
            for k, (_, fault) in enumerate(part)
        ]
        judged = [
            judge_all(blocks, bus_map.names, model, each, CONFIG, keep_banks=False)
            for each in (limits, replace(limits, fuel_cut=None))
        ]
        found += zip((name for name, _ in part), *judged, strict=True)
    table(found, limits, model.card.transform)


def _driven(first: int, k: int, fault: Fault, model: Model, *, is_linear: bool) -> SampleBlock:
    """Return the samples of one drive."""
    seed, bus_map = first * 1000 + k, ecu.own_bus()
    rng = np.random.default_rng(seed)
    experiment = Experiment(
        CYCLES[k % len(CYCLES)],
        vehicle=first + k,
        seed=seed,
        fault=fault,
        conditions=weather(AMBIENTS[k // len(CYCLES) % len(AMBIENTS)], seed),
        effects=from_severities({"ethanol": float(rng.integers(0, 11))}),
        linear_reading=is_linear,
    )
    sent = ecu.broadcast(simulate(experiment), bus_map, rng, fault, 0.0)
    return ecu.samples(sent, bus_map, model.card.period_ns)


def dead(first: int, drives: int) -> None:
    """Judge simulated drives whose sensor dies, and the same drives without a fault."""
    model, bus_map = Model.load(shipped_model()), ecu.own_bus()
    limits = Limits.from_card(model.card, CONFIG, str(model.path))
    healthy, named, found, seconds = 0, 0, 0, list[float]()
    for k in range(drives):
        block = _driven(first, k, ageing(first * 1000 + k), model, is_linear=False)
        values, place = block.values.copy(), bus_map.names.index(OUTPUT)
        begin = len(values) * 2 // 5
        fault = SensorFault(faults.resolve("no_activity", 0.003), model.card.period_ns / 1e9)
        values[begin:, place] = fault.apply(values[begin:, place].tolist())
        blocks = [block, block._replace(values=values)]
        sound, died = judge_all(blocks, bus_map.names, model, limits, CONFIG, keep_banks=False)
        healthy += bool(sound.dtcs)
        found += bool(died.dtcs)
        own = [dtc for dtc in died.dtcs if dtc.fault == "no_activity" and dtc.t_ns is not None]
        named += len(own) == len(died.dtcs) == 1
        seconds += [(dtc.t_ns - block.t_ns.item(begin)) / 1e9 for dtc in own if dtc.t_ns]
    print(
        f"{drives} healthy drives: {healthy} with a code; a dead sensor: {found} found, {named} "
        f"named, after {np.median(seconds):.0f} s (median)"
    )


def bosch(folder: Path, name: str, budget: str, work: Path) -> None:
    """Fit a model of a split's training runs; judge its other runs."""
    split, columns, path = bosch_verdicts.SPLITS[name], work / "columns.toml", work / "bosch.onnx"
    columns.write_text(MASK)
    bosch_verdicts.fit(folder, split, columns, budget, path)
    model = Model.load(path)
    limits = Limits.from_card(model.card, CONFIG, str(path))
    found: list[Drive] = []
    for run in split.test:
        recording = load(folder / f"run_{run:06d}.csv.gz", columns=columns)
        cases = bosch_verdicts.drives(recording)
        judged = judge_recordings([each for _, each in cases], model, limits, CONFIG)
        found += [(fault, each, each) for (fault, _), each in zip(cases, judged, strict=True)]
    table(found, limits, model.card.transform)


def logs(folder: Path, budget: str, work: Path) -> None:
    """Judge each log by a model of the others."""
    paths = sorted(path for path in folder.iterdir() if path.is_file())
    for i, left_out in enumerate(paths):
        path, others = work / f"{i}.onnx", [str(each) for each in paths if each != left_out]
        cli.main(["fit", *others, "--out", str(path), "--budget", budget])
        model = Model.load(path)
        limits = Limits.from_card(model.card, CONFIG, str(path))
        print(f"\n{left_out.name}")
        table(list(_put_on(left_out, model, limits)), limits, model.card.transform)


def _put_on(path: Path, model: Model, limits: Limits) -> Iterator[Drive]:
    """Yield the log as it is and with each response fault on its reading."""
    recording = load(path, period_s=model.card.period_ns / 1e9)
    place = recording.names.index(OUTPUT)
    for name, severity in (("", 0.0), *bosch_verdicts.FAULTS):
        values = recording.values.copy()
        if name:
            fault = SensorFault(faults.resolve(name, severity), model.card.period_ns / 1e9)
            values[:, place] = fault.apply(values[:, place].tolist())
        with_level, without = (
            judge_recordings([replace(recording, values=values)], model, each, CONFIG)[0]
            for each in (limits, replace(limits, fuel_cut=None))
        )
        yield name, with_level, without


def main(argv: Sequence[str]) -> int:
    """Run one of the four."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    kinds = parser.add_subparsers(dest="kind", required=True)
    own = kinds.add_parser("simulated")
    own.add_argument("first_vehicle", type=int)
    own.add_argument("--healthy", type=int, default=100)
    own.add_argument("--faulty", type=int, default=10, help="drives for each fault")
    own.add_argument("--linear", type=Path, help="model of an ECU that reads 2.0 in air")
    own = kinds.add_parser("dead")
    own.add_argument("first_vehicle", type=int)
    own.add_argument("--healthy", type=int, default=100, help="drives")
    for kind in ("bosch", "logs"):
        real = kinds.add_parser(kind)
        real.add_argument("folder", type=Path)
        if kind == "bosch":
            real.add_argument("split", choices=("1a", "1b"))
        real.add_argument("--budget", default="2" if kind == "logs" else "8")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        if args.kind == "simulated":
            simulated(args.first_vehicle, args.healthy, args.faulty, args.linear)
        elif args.kind == "dead":
            dead(args.first_vehicle, args.healthy)
        elif args.kind == "bosch":
            bosch(args.folder, args.split, args.budget, Path(name))
        else:
            logs(args.folder, args.budget, Path(name))
    return 0
