"""Real logs of tuning tools: read, a model learned, logs left out predicted and judged.

FOLDER holds logs, one folder per vehicle and logger; a loose table is a vehicle alone. For each
vehicle the last log is left out of the fit; a vehicle with one log has its last 40 % of rows left
out, behind a guard of 60 s that nobody uses. All figures are of what is left out:

- free run: correlation r and fit of the model that reads only its own past;
- healthy: codes (each is a false alarm, as far as is known), and the share of time in windows with
  a verdict;
- faults put on the recorded lambda behind the control loop: how many give a code, how many the
  right one.

Nobody knows whether these sensors were sound. Logs without a lambda are read and listed.

python -m benchmarks real_logs [FOLDER] [--profiles DIR] [--budget MINUTES] [--only TEXT]
    [--kind narx|greybox] [--work DIR]

``--work`` keeps models and tables in DIR, one folder per vehicle, and uses the models it finds
there. A profile in DIR (default: ``profiles`` beside this file) with the name of a vehicle's
folder or file is given with its logs.
"""

import gzip
import io
import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from monitor.base.config import load as load_config
from monitor.base.errors import O2Error
from monitor.base.faults import resolve
from monitor.base.signals import OUTPUT
from monitor.grid.tables import Table, is_table, read_table
from monitor.model.step import Model
from monitor.pipeline import replay
from training.cli import main as o2train
from training.limits.judging import judge_recordings
from training.recordings.recording import Recording, load
from training.recordings.samples.preparation import pinned_rows
from training.recordings.sensor_fault import faulty_readings

FAULTS: Final = (
    *("slow_symmetric", "slow_rich_to_lean", "slow_lean_to_rich"),
    *("delay_symmetric", "delay_rich_to_lean", "delay_lean_to_rich"),
    *("gain_low", "biased_lean", "biased_rich", "stuck_lean", "stuck_rich", "stuck_at_one"),
)
PART: Final = 0.6  # of a vehicle's only log that is fitted
GUARD_S: Final = 60.0  # between the fitted and the left-out part of a log
LEAST_S: Final = 60.0  # of a log that is worth a fit
NOTHING: Final = dict.fromkeys(("r", "fit %", "windows", "judged", "found", "named"), None)


@dataclass(frozen=True, slots=True)
class LoggedVehicle:
    """The logs of one vehicle."""

    name: str
    paths: tuple[Path, ...]
    profile: Path | None


def vehicles(folder: Path, profiles: Path | None) -> Iterator[LoggedVehicle]:
    for place in sorted(folder.iterdir()):
        paths = sorted(place.iterdir()) if place.is_dir() else [place]
        paths = [path for path in paths if path.is_file() and is_table(path)]
        alike = _alike(paths)
        for group in alike:
            name = place.name if len(alike) == 1 else group[0].name
            own = profiles / f"{name.split('.')[0]}.toml" if profiles else None
            yield LoggedVehicle(name, tuple(group), own if own and own.is_file() else None)


def _alike(paths: Sequence[Path]) -> list[list[Path]]:
    """Return groups of logs with the same beginning of names: of one vehicle."""
    groups: dict[str, list[Path]] = {}
    for path in paths:
        groups.setdefault(path.suffix + path.name[:4].strip("0123456789"), []).append(path)
    return list(groups.values())


def parts(path: Path, span_s: float, into: Path) -> tuple[Path, Path]:
    """Write the first and the last rows of a text log of ``span_s`` as two logs.

    The rows of ``GUARD_S`` between them are in neither; rows are taken as evenly spaced.
    """
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rb") as file:
        lines = file.read().splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if i and line[:1].isdigit())
    rows = len(lines) - first
    cut = first + round(PART * rows)
    guard = round(GUARD_S / max(span_s, GUARD_S) * rows)
    name = path.name.removesuffix(".gz")
    fitted, left_out = into / f"first_{name}", into / f"last_{name}"
    fitted.write_bytes(b"".join(lines[:cut]))
    left_out.write_bytes(b"".join((*lines[:first], *lines[cut + guard :])))
    return fitted, left_out


def quietly(*arguments: str | Path) -> tuple[int, str]:
    text = io.StringIO()
    with redirect_stdout(text), redirect_stderr(text):
        code = o2train([str(each) for each in arguments])
    return code, text.getvalue()


def faulty(recording: Recording, name: str) -> Recording:
    """Return the recording with a fault on its lambda, from a third of its readings on.

    Readings at an end of the range outside fuel cuts stay as they are, since nobody knows the
    mixture there, and are no readings of a sensor that is not ready yet.
    """
    place, values = recording.names.index(OUTPUT), recording.values.copy()
    healthy = values[:, place].copy()
    at_end = pinned_rows(recording, OUTPUT)
    readings = np.flatnonzero(np.isfinite(healthy) & ~at_end)
    begin = int(readings[len(readings) // 3])
    period_s = recording.period_ns / 1e9
    values[begin:, place] = faulty_readings(resolve(name), healthy[begin:], period_s)
    values[at_end, place] = healthy[at_end]
    return replace(recording, values=values)


def row_of(vehicle: LoggedVehicle, work: Path, kind: str, budget: float) -> dict[str, Any]:
    """Return the figures of a vehicle."""
    tables = [read_table(path, vehicle.profile) for path in vehicle.paths]
    spans_s = [(int(t.t_ns[-1]) - int(t.t_ns[0])) / 1e9 for t in tables]
    row = {
        "vehicle": vehicle.name[:25],
        "profile": tables[0].profile or "own",
        "logs": len(tables),
        "s": round(sum(spans_s)),
        "rows/s": sum(len(t.t_ns) for t in tables) / max(sum(spans_s), 1e-9),
        "signals": len(tables[0].names),
        "codes": "no usable lambda",
        **NOTHING,
    }
    say(f"\n{vehicle.name}: {', '.join(tables[0].names)}")
    for table in tables:
        for note in table.notes.lines:
            say(f"  {table.path.name}: {note}")
    if OUTPUT not in tables[0].names or sum(spans_s) < LEAST_S or _stands(tables):
        return row
    *fitted, left_out = (
        vehicle.paths if len(tables) > 1 else parts(vehicle.paths[0], spans_s[0], work)
    )
    return row | _scored(vehicle, fitted, left_out, work=work, kind=kind, budget=budget)


def _stands(tables: Sequence[Table]) -> bool:
    values = np.concatenate([t.values[:, t.names.index(OUTPUT)] for t in tables])
    return bool(np.nanstd(values) < 1e-6)


def _scored(
    vehicle: LoggedVehicle, fitted: list[Path], left_out: Path, work: Path, kind: str, budget: float
) -> dict[str, Any]:
    model, figures = work / "model.onnx", work / "figures.json"
    own = ("--profile", vehicle.profile) if vehicle.profile else ()
    limit = ("--budget", str(budget)) if kind == "narx" else ()
    if not model.exists():
        code, said = quietly("fit", *fitted, "--out", model, "--kind", kind, *limit, *own)
        if code:
            return {"codes": said.strip().splitlines()[-1][-60:]}
        for line in said.splitlines():
            if "no decision limits" in line:
                say(f"  {line}")
    say(f"  inputs: {', '.join(Model.load(model).card.input_names)}")
    code, said = quietly("evaluate", "--model", model, left_out, "--json", figures, *own)
    if code:
        return {"codes": said.strip().splitlines()[-1][-60:]}
    scores = json.loads(figures.read_text())["recordings"][0]
    row = {"r": scores["correlation"], "fit %": scores["fit_percent"]}
    try:
        setup = replay.set_up(model, [], load_config(None), vehicle.profile)
    except O2Error:
        return row | {"codes": "too short for limits"}
    healthy, _ = replay.replay(left_out, setup)
    codes = " ".join(sorted({dtc["fault"] for dtc in healthy["dtcs"]})) or "none"
    recording = load(left_out, period_s=setup.model.card.period_ns / 1e9, columns=vehicle.profile)
    found = named = 0
    for name in FAULTS:
        drive = faulty(recording, name)
        verdict = judge_recordings([drive], setup.model, setup.limits, setup.config)[0]
        given = {fault for dtc in verdict.dtcs for fault in (dtc.fault, *dtc.also)}
        found, named = found + bool(given), named + (name in given)
        best = max((w.response.evidence for w in verdict.windows), default=0.0)
        say(f"  {name}: {' or '.join(sorted(given)) or '-'}; evidence up to {best:.1f}")
    return row | {
        "codes": codes if healthy["completed"] or codes != "none" else "not judged",
        "windows": max(healthy["samples"] // 50, 1),
        "judged": sum(w["verdict"] != "inconclusive" for w in healthy["windows"]),
        "found": found,
        "named": named,
    }


def main(argv: Sequence[str]) -> int:
    """Read, fit and judge each vehicle's logs."""
    options = BenchmarkOptions(__name__, __doc__, budget=0.02, only="mx5")
    options.add_argument("folder", nargs="?", type=Path, default=Path("../shared/data/logs"))
    options.add_argument("--profiles", type=Path, default=Path(__file__).parent / "profiles")
    options.add_argument("--budget", type=float, default=2.0)
    options.add_argument("--kind", choices=("narx", "greybox"), default="narx")
    options.add_argument("--only", default="", help="vehicles whose names hold this text")
    options.add_argument("--work", type=Path, help="keeps models and tables here")
    args = options.parse_args(argv)
    rows: list[Row] = []
    for vehicle in vehicles(args.folder, args.profiles):
        if args.only not in vehicle.name:
            continue
        with tempfile.TemporaryDirectory() as spare:
            work = args.work / vehicle.name if args.work else Path(spare)
            work.mkdir(parents=True, exist_ok=True)
            try:
                rows.append(row_of(vehicle, work, args.kind, args.budget))
            except O2Error as error:
                rows.append({"vehicle": vehicle.name, "codes": str(error)[-60:], "logs": 0})
    return finish(args, rows)
