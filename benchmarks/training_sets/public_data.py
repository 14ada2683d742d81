"""The files of public system identification benchmarks, as ``nonlinear_benchmarks`` stores them.

The files are the user's to bring; the package downloads them to its own folder (on Linux
``~/.nonlinear_benchmarks``). A file is found by its name anywhere below the folder:

====================  ==========================  =========================================
plant                 file                        variables
====================  ==========================  =========================================
cascaded tanks        dataBenchmark.mat           uEst, yEst, uVal, yVal (n, 1), Ts
Silverbox             SNLS80mV.mat                V1, V2 (1, n)
Wiener-Hammerstein    WienerHammerBenchMark.mat   uBenchMark, yBenchMark (n, 1), fs
coupled drives (CED)  DATAUNIF.MAT                u11, z11, u12, z12 (n, 1)
pilot plant           pilotPlant.mat              those of the tanks; more inputs as columns
====================  ==========================  =========================================

Training and test parts, and the measured samples that begin a test, are those of the package,
version 1.0.1. The pilot plant is not in the package: save it in the layout of the tanks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

SILVERBOX_HZ = 610.35
CED_PERIOD_S = 0.02
ARROW, NO_EXTRAPOLATION, MULTISINE = slice(100, 40_575), 32_000, slice(40_650, 127_400)
WIENER_HAMMERSTEIN, WIENER_HAMMERSTEIN_TRAIN = slice(5_200, 184_000), 100_000
CED_TRAIN = 400


@dataclass(frozen=True, slots=True)
class PlantRecord:
    """One measurement."""

    u: np.ndarray  # (n, k) inputs
    y: np.ndarray  # (n,) output

    def __getitem__(self, part: slice) -> "PlantRecord":
        return PlantRecord(self.u[part], self.y[part])


@dataclass(frozen=True, slots=True)
class Plant:
    """Training and test records of one plant."""

    name: str
    period_s: float
    unit: str  # of the table
    per_unit: float  # table's unit per file's unit
    washout: int  # measured samples that begin a test and are not scored
    train: tuple[PlantRecord, ...]
    tests: dict[str, PlantRecord]
    goals: dict[str, float]  # of the project: median of the seeds, in the table's unit


def _record(u: Any, y: Any) -> PlantRecord:
    columns = np.asarray(u, float)
    columns = columns.T if columns.shape[0] == 1 else columns
    return PlantRecord(columns, np.asarray(y, float).ravel())


def tanks(file: Path) -> Plant:
    """Cascaded tanks with overflow: pump voltage, level in V; 1,024 samples each."""
    return _two_records(file, "cascaded tanks", "V", 0.33)


def pilot_plant(file: Path) -> Plant:
    """Level in mm."""
    return _two_records(file, "pilot plant", "mm", 25.0)


def _two_records(file: Path, name: str, unit: str, goal: float) -> Plant:
    content = loadmat(file)
    return Plant(
        name=name,
        period_s=float(np.ravel(content["Ts"])[0]),
        unit=unit,
        per_unit=1.0,
        washout=50,
        train=(_record(content["uEst"], content["yEst"]),),
        tests={"test": _record(content["uVal"], content["yVal"])},
        goals={"test": goal},
    )


def silverbox(file: Path) -> Plant:
    """Electronic hardening oscillator; the arrow's tip exceeds the amplitude of the training."""
    content = loadmat(file)
    whole = _record(content["V1"], content["V2"])
    multisine = whole[MULTISINE]
    n = int(0.75 * len(multisine.y))
    return Plant(
        name="Silverbox",
        period_s=1.0 / SILVERBOX_HZ,
        unit="mV",
        per_unit=1e3,
        washout=50,
        train=(multisine[:n],),
        tests={
            "multisine": multisine[n:],
            "full arrow": whole[ARROW],
            "arrow, no extrapolation": whole[ARROW][:NO_EXTRAPOLATION],
        },
        goals={"multisine": 0.24, "full arrow": 0.31},
    )


def wiener_hammerstein(file: Path) -> Plant:
    """A diode circuit between two filters."""
    content = loadmat(file)
    system = _record(content["uBenchMark"], content["yBenchMark"])[WIENER_HAMMERSTEIN]
    return Plant(
        name="Wiener-Hammerstein",
        period_s=1.0 / float(np.ravel(content["fs"])[0]),
        unit="mV",
        per_unit=1e3,
        washout=50,
        train=(system[:WIENER_HAMMERSTEIN_TRAIN],),
        tests={"test": system[WIENER_HAMMERSTEIN_TRAIN:]},
        goals={},
    )


def ced(file: Path) -> Plant:
    """Coupled electric drives: two records of 500 samples, a speed without its sign."""
    content = loadmat(file)
    records = [_record(content[f"u1{i}"], content[f"z1{i}"]) for i in (1, 2)]
    tests = {n: r[CED_TRAIN:] for n, r in zip(("low input", "high input"), records, strict=True)}
    return Plant(
        name="CED",
        period_s=CED_PERIOD_S,
        unit="ticks/s",
        per_unit=1.0,
        washout=10,
        train=tuple(r[:CED_TRAIN] for r in records),
        tests=tests,
        goals={},
    )


PLANTS: dict[str, tuple[str, Callable[[Path], Plant]]] = {
    "tanks": ("dataBenchmark.mat", tanks),
    "silverbox": ("SNLS80mV.mat", silverbox),
    "wiener_hammerstein": ("WienerHammerBenchMark.mat", wiener_hammerstein),
    "ced": ("DATAUNIF.MAT", ced),
    "pilot_plant": ("pilotPlant.mat", pilot_plant),
}


def find(folder: Path, name: str) -> Plant | None:
    """Return the plant from its file below ``folder``, whatever the name's case, or None."""
    file, read = PLANTS[name]
    for path in sorted(folder.rglob("*.[mM][aA][tT]")):
        if path.name.lower() == file.lower():
            return read(path)
    return None
