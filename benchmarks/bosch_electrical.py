"""Electrical faults on runs of a Bosch engine, judged by a model of one other run.

Real recordings as in ``bosch_verdicts.py``. From a third of a run on, the reading is frozen, at an
end of its range, or that of a dead sensor with noise; the control loop did not see it. A healthy
run should have no code of the electrical tests.

    python benchmarks/bosch_electrical.py FOLDER ENGINE:RUN [--model MODEL] [--budget MINUTES]

FOLDER holds the runs of the engine; one run trains and all others are judged.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from bosch import OUTPUT
from bosch_verdicts import model_of, split_of

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from monitor.memory.codes import TESTS
from monitor.model.step import Model
from training.limits.judging import judge_recordings
from training.recordings.recording import Recording, load

ENDS_Z: Final = {True: (-4.0, 7.746), False: (-6.2, 0.298)}  # of engine 1, of engine 2; rich, lean
BEFORE: Final = 50  # samples, whose median a dead sensor reads
ELECTRICAL: Final = {*TESTS["activity"], "no_activity", "intermittent"}

Fault = Callable[[FloatArray, int, tuple[float, float]], FloatArray | float]


def dead(noise_z: float) -> Fault:
    """Return a fault: a constant with noise."""

    def read(measured: FloatArray, begin: int, ends: tuple[float, float]) -> FloatArray:
        rng = np.random.default_rng(begin)
        level = np.median(measured[begin - BEFORE : begin])
        return np.asarray(level + noise_z * rng.standard_normal(len(measured) - begin))

    return read


FAULTS: Final[dict[str, Fault]] = {
    "frozen": lambda measured, begin, ends: measured.item(begin),
    "rich end": lambda measured, begin, ends: ends[0],
    "lean end": lambda measured, begin, ends: ends[1],
    "dead, noise 0.047 z": dead(0.047),
    "dead, noise 0.01 z": dead(0.01),
}


def put_on(recording: Recording, fault: Fault, ends: tuple[float, float]) -> Recording:
    values, place = recording.values.copy(), recording.names.index(OUTPUT)
    begin = len(values) // 3
    values[begin:, place] = fault(values[:, place], begin, ends)
    return replace(recording, values=values)


def main() -> None:
    """Fit unless a model is given, then count the codes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("split", type=split_of)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--budget", default="0.6")
    args = parser.parse_args()
    split, settings = args.split, config.load()
    given = args.folder, split, args.model, args.budget
    with model_of(*given, masks=split.has_cut) as (path, columns):
        model = Model.load(path)
        limits = Limits.from_card(model.card, settings, str(path))
        files = [args.folder / f"run_{run:06d}.csv.gz" for run in split.test]
        runs = [load(file, columns=columns) for file in files]
    print(f"still_s {limits.still_s:.4g}, still_end_s {limits.still_end_s:.4g}")
    cases = {"healthy": runs}
    for title, fault in FAULTS.items():
        cases[title] = [put_on(run, fault, ENDS_Z[split.has_cut]) for run in runs]
    for title, drives in cases.items():
        judged = judge_recordings(drives, model, limits, settings)
        found = [any(dtc.fault in ELECTRICAL for dtc in each.dtcs) for each in judged]
        print(f"{title}: {sum(found)} of {len(found)} with an electrical code", flush=True)


if __name__ == "__main__":
    main()
