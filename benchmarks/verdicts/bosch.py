"""Lambda on real recordings of a Bosch engine, with faults added afterwards.

Training uses runs 10 to 15 and 30 to 33, the test runs 53 and 54; 10 Hz, all channels z-scored by
their authors (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0). The faults are added to the
measured lambda, so the control loop does not see them. Each test run is judged whole, and also cut
into four separate drives.

The scale of z is not published. Lambda saturates at z = 7.746 and stays at -0.065 in closed loop.
If the first is lambda 1.5 and the second lambda 1, one z is 0.064 lambda, and the richest reading
of the test runs is 0.69. Offsets use this scale; lags, dead times and gains need none, and the gain
acts around z = -0.065. ``--mask`` maps the fuel cut-off to the enable conditions, so that windows
exclude fuel cut and the recovery from it.

    python -m benchmarks bosch FOLDER [--model MODEL] [--budget MINUTES] [--mask]
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from monitor.base import config, faults
from monitor.base.faults import Fault, lag_step, one_sided
from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from monitor.model.step import Model
from training import cli
from training.limits.judging import Judged, judge_recordings
from training.recordings import metrics
from training.recordings.recording import Recording, load

INPUTS = ("speed_z", "load_z", "ignition_angle_z", "fuel_cutoff_z")
OUTPUT = "lambda_z"
TRAINING = (10, 11, 12, 13, 14, 15, 30, 31, 32, 33)
TEST = (53, 54)
QUARTERS = 4
STOICHIOMETRIC_Z = -0.065  # median of all runs outside fuel cut
LAMBDA_PER_Z = 0.064  # see above
SIDES = ("rich_to_lean", "lean_to_rich", "symmetric")
FAULTS = (
    *((f"slow_{side}", s) for side in SIDES for s in (0.3, 0.6, 1.0)),
    *((f"delay_{side}", s) for side in SIDES for s in (0.2, 0.4, 0.8)),
    ("transient", 0.6),
    *(("gain_low", s) for s in (0.6, 0.4)),
    *((name, s) for name in ("biased_lean", "biased_rich") for s in (0.05, 0.1)),
)
# z = -0.11644 is no cut; the channel is binary, so z * std + mean = 0 or 1
MASK = """
time_s = "time_s"
speed_z = "speed_z"
load_z = "load_z"
ignition_angle_z = "ignition_angle_z"
fuel_cutoff_z = "fuel_cutoff_z"
lambda_z = "lambda_z"
fuel_cut = { column = "fuel_cutoff_z", factor = 0.11365, offset = 0.0132335 }
"""


@dataclass(frozen=True, slots=True)
class Drive:
    """A test run or a quarter of it, healthy or with a fault put on afterwards."""

    name: str
    whole: bool
    fault: Fault | None
    recording: Recording

    @property
    def title(self) -> str:
        """Return fault and severity."""
        return f"{self.fault.name} {self.fault.severity:g}" if self.fault else "healthy"


def faulty(values: FloatArray, fault: Fault, period_s: float) -> FloatArray:
    """Return what the faulty sensor reads, (n,) z; rising phi is falling z."""
    u = STOICHIOMETRIC_Z - values
    late = round(fault.delay_s / period_s)
    delayed = np.concatenate([np.full(late, u[0]), u[: len(u) - late]])
    x, read = float(u[0]), np.empty(len(u))
    for k in range(len(u)):
        seen = one_sided(float(u[k]), float(delayed[k]), fault.delay_direction)
        x = lag_step(x, seen, fault.tau_rising_s, fault.tau_falling_s, period_s)
        read[k] = fault.gain * x
    return np.asarray(STOICHIOMETRIC_Z - read + fault.offset_lambda / LAMBDA_PER_Z)


def drives_of(recording: Recording, name: str) -> list[Drive]:
    """Return the run and its quarters, healthy and with every fault."""
    n, column = len(recording.values), recording.names.index(OUTPUT)
    edges = np.linspace(0, n, QUARTERS + 1).astype(int).tolist()
    parts = [
        (name, 0, n),
        *((f"{name}, quarter {i + 1}", a, b) for i, (a, b) in enumerate(pairwise(edges))),
    ]
    found = []
    for fault in (None, *(faults.resolve(*each) for each in FAULTS)):
        values = recording.values.copy()
        if fault:
            values[:, column] = faulty(values[:, column], fault, recording.period_ns / 1e9)
        for title, a, b in parts:
            part = replace(
                recording,
                t_s=recording.t_s[: b - a],
                values=values[a:b],
                quality=recording.quality[a:b],
            )
            found.append(Drive(title, b - a == n, fault, part))
    return found


def row(drive: Drive, judged: Judged) -> str:
    """Return one line of the table of whole runs."""
    windows = judged.windows
    count = Counter(w.outcome for w in windows)
    period_ns = drive.recording.period_ns
    codes = (
        ", ".join(f"{d.code} {d.fault}{''.join(f' or {a}' for a in d.also)}" for d in judged.dtcs)
        or "none"
    )
    first_ns = min((d.t_ns for d in judged.dtcs), default=None)
    if first_ns is None:
        seconds = "-"
    else:
        seconds = f"{judged.enabled[: first_ns // period_ns + 1].sum() * period_ns / 1e9:.0f}"
    paper = 100.0 * sum(w.paper_failed for w in windows) / max(len(windows), 1)
    return (
        f"| {drive.name} | {drive.title} | {len(windows)} | {count['passed']} / {count['failed']} "
        f"/ {count['inconclusive']} | {codes} | {seconds} | {paper:.1f} % |"
    )


def names(judged: Judged) -> set[str]:
    """Return the faults that stand at the end."""
    return {d.fault for d in judged.dtcs}


def summary(title: str, group: Sequence[tuple[Drive, Judged]]) -> str:
    """Return one line on all quarters with one fault."""
    wanted = group[0][0].fault
    found = sum(bool(judged.dtcs) for _, judged in group)
    named = sum(names(judged) == {wanted.name} for _, judged in group) if wanted else 0
    sound = sum(judged.completed and not judged.dtcs for _, judged in group)
    others = Counter(
        n for _, judged in group for n in names(judged) if not wanted or n != wanted.name
    )
    told = ", ".join(f"{n} {k}" for n, k in sorted(others.items())) or "-"
    wins = [w for _, judged in group for w in judged.windows]
    paper = 100.0 * sum(w.paper_failed for w in wins) / max(len(wins), 1)
    return (
        f"| {title} | {len(group)} | {found} | {named if wanted else '-'} | {sound} | "
        f"{len(group) - found - sound} | {told} | {paper:.1f} % |"
    )


def report(drives: Sequence[Drive], path: Path) -> None:
    """Judge the drives and print both tables."""
    model, settings = Model.load(path), config.load()
    limits = Limits.from_card(model.card, settings, str(path))
    results = judge_recordings([d.recording for d in drives], model, limits, settings)
    pairs = list(zip(drives, results, strict=True))
    for drive, judged in pairs:
        if drive.whole and drive.fault is None:
            on = judged.enabled & np.isfinite(judged.predicted)
            fit = metrics.fit_percent(judged.measured[on], judged.predicted[on])
            print(
                f"{drive.name}: enabled {on.sum()} of {len(on)} samples, fit {fit:.1f} %, "
                f"max |prediction| {np.nanmax(np.abs(judged.predicted)):.2f} z"
            )
    used = ", ".join(f"{n} {v.value:.4g}" for n, v in model.card.limits.items())
    print(f"limits: {used}\n")
    print(
        "| run | sensor | windows | passed / failed / inconclusive | codes | enabled s to the "
        "first code | paper's rule |\n|---|---|---|---|---|---|---|"
    )
    for drive, judged in sorted((p for p in pairs if p[0].whole), key=lambda p: p[0].name):
        print(row(drive, judged))
    print(
        "\n| quarters of the runs | drives | code | named exactly | passed | not judged | "
        "other names | paper's rule |\n|---|---|---|---|---|---|---|---|"
    )
    for title in dict.fromkeys(d.title for d in drives):
        print(summary(title, [p for p in pairs if not p[0].whole and p[0].title == title]))


def main(argv: Sequence[str]) -> int:
    """Fit unless a model is given, then judge the test runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--budget", default="10")
    parser.add_argument("--mask", action="store_true")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        columns = Path(name) / "columns.toml"
        columns.write_text(MASK)
        mask = ["--columns", str(columns)] if args.mask else []
        path = args.model or Path(name) / "bosch.onnx"
        if not args.model:
            runs = [str(args.folder / f"run_{n:06d}.csv.gz") for n in TRAINING]
            used = ["--inputs", *INPUTS, "--output", OUTPUT, "--budget", args.budget]
            cli.main(["fit", *runs, *mask, *used, "--out", str(path)])
        drives = []
        for run in TEST:
            file = args.folder / f"run_{run:06d}.csv.gz"
            recording = load(file, columns=columns if args.mask else None)
            drives += drives_of(recording, str(run))
        report(drives, path)
    return 0
