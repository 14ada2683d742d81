"""Time of ``o2train gap``, as a whole command and by stage, compared with its targets.

The first case has ten recordings of ten minutes at 10 Hz with a hidden effect, ten healthy ones,
all candidates, one step and a grey-box base, from tables to the report. It is run twice: the second
time the vehicle's healthy behaviour is read from the cache. The second case is one of the study:
only the naming of six recordings, with a healthy reference made before. All drives are simulated;
the time for simulating them and fitting the base does not count.

    python benchmarks/gap.py [--vehicle N] [--effect NAME=SEVERITY]
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from threadpoolctl import threadpool_limits

from monitor.base import config
from training.dyno.effects import from_severities
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.gap.inputs.roles import Material, Options
from training.gap.name import yardstick
from training.gap.name.naming import name
from training.gap.name.verdict import Naming
from training.gap.pages import gap_page
from training.gap.result import Result, save
from training.gap.workflow import investigate
from training.greybox.chain import Constants
from training.greybox.fit.case import NAMED
from training.greybox.fit.drive import from_recording
from training.greybox.model import fit_greybox
from training.jobs.checkpoints import Checkpoints
from training.limits.decision_limits import set_limits
from training.recordings.recording import Recording, load

CYCLES: Final = ("wltc_3b", "micro_trips", "udds", "us06", "hwfet")
DRIVES, STUDY_DRIVES, DURATION_S = 10, 6, 600.0
WHOLE_MOST_S, STUDY_MOST_S = 30.0, 15.0
COMMAND: Final = "from o2_monitor import o2train; raise SystemExit(o2train())"
FIRST_SEED: Final = 2_900_000  # 100 further for the drives with the effect
WORDS: Final = {
    "read": "read 20 tables",
    "healthy": "learn the healthy recordings, and how they differ",
    "where": "localise: wait for the process that does it",
    "name": "name",
    "verify": "verify, with faults put on",
    "rest": "prepare, fit again, add",
    "write": "report and gap.json",
}


@dataclass(frozen=True, slots=True)
class Clock(Checkpoints):
    """Checkpoints that are timed: wall and processor seconds."""

    seconds: dict[str, tuple[float, float]] = field(default_factory=dict)

    def done(self, name: str, kind: Any, make: Callable[[], Any]) -> Any:
        """Return a stage's result."""
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        result = Checkpoints.done(self, name, kind, make)
        self.seconds[name] = (time.perf_counter() - wall_s, time.process_time() - cpu_s)
        return result


def tables(folder: Path, vehicle: int, seed: int, effects: dict[str, float]) -> list[Path]:
    """Write ten simulated drives; return their paths."""
    folder.mkdir()
    return [
        write(
            Experiment(
                cycle=CYCLES[i % len(CYCLES)],
                vehicle=vehicle,
                seed=seed + i,
                effects=from_severities(effects),
                duration_s=DURATION_S,
            ),
            folder,
            "parquet",
        )
        for i in range(DRIVES)
    ]


def base(recordings: list[Recording], out: Path) -> Path:
    """Fit the chain, with limits for the monitor."""
    fitted = fit_greybox(recordings, out)
    set_limits(out, recordings, fitted.held_out, config.load())
    return out


def whole(model: Path, new: list[Path], healthy: list[Path], folder: Path) -> Clock:
    """Return the times of one case, its verdict printed.

    The healthy vehicle is learned in the first case of a folder, and read in the next ones.
    """
    clock = Clock()
    learned = Clock(folder / "learned", "vehicle", NAMED, clock.seconds)
    given = clock.done(
        "read",
        Material,
        lambda: Material(model, [load(p) for p in new], [load(p) for p in healthy]),
    )
    found = clock.done(
        "rest",
        Result,
        lambda: investigate(given, folder, Options(), stages=clock, learned=learned),
    )
    inside = [clock.seconds[each] for each in ("healthy", "where", "name", "verify")]
    wall_s, cpu_s = clock.seconds["rest"]
    clock.seconds["rest"] = (wall_s - sum(w for w, _ in inside), cpu_s - sum(c for _, c in inside))
    clock.done("write", type(None), lambda: _written(found, folder))
    print(f"verdict: {found.verdict}, {', '.join(c.name for c in found.effects) or 'no name'}")
    return clock


def command(model: Path, new: list[Path], healthy: list[Path], folder: Path) -> tuple[float, float]:
    """Return the wall and processor seconds of the whole command with its cache in a folder."""
    files = ["--model", model, *new, "--healthy", *healthy, "--out", folder / "out"]
    wall_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", COMMAND, "gap", *files],
        env=os.environ | {"XDG_CACHE_HOME": str(folder)},
        check=True,
        capture_output=True,
    )
    wall_s, after = time.perf_counter() - wall_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, cpu_s


def study(new: list[Path], healthy: list[Path]) -> tuple[float, float]:
    """Return the wall and processor seconds of naming alone."""
    drives, known = ([from_recording(load(p)) for p in each] for each in (new, healthy))
    taught = yardstick.learn(known, Constants())
    clock = Clock()
    found = clock.done("name", Naming, lambda: name(drives[:STUDY_DRIVES], taught))
    print(f"verdict of the study's case: {found.verdict}")
    return clock.seconds["name"]


def _row(words: str, *times: tuple[float, ...]) -> None:
    print(f"{words:52s}" + "".join(f" {wall_s:6.1f} {cpu_s:12.1f}" for wall_s, cpu_s in times))


def _written(found: Any, folder: Path) -> None:
    save(found, folder / "gap.json")
    gap_page.save(found, folder / "report.html")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicle", type=int, default=2001)
    parser.add_argument("--effect", default="wall_film=4", metavar="NAME=SEVERITY")
    args = parser.parse_args()
    effect, _, severity = args.effect.partition("=")
    with tempfile.TemporaryDirectory() as folder_name, threadpool_limits(1):
        folder = Path(folder_name)
        healthy = tables(folder / "healthy", args.vehicle, FIRST_SEED, {})
        hidden = {effect: float(severity)}
        new = tables(folder / "new", args.vehicle, FIRST_SEED + 100, hidden)
        model = base([load(p) for p in healthy], folder / "base.onnx")
        commands = [command(model, new, healthy, folder / "command") for _ in range(2)]
        clock = whole(model, new, healthy, folder / "gap")
        again = whole(model, new, healthy, folder / "gap")
        study_s = study(new, healthy)
    print(f"{'':52s} wall s  processor s  again: wall s  processor s")
    for stage, words in WORDS.items():
        _row(words, clock.seconds[stage], again.seconds[stage])
    first, second = (
        tuple(sum(each[i] for each in clock.seconds.values()) for i in (0, 1))
        for clock in (clock, again)
    )
    _row("all stages, of this process", first, second)
    _row(f"whole command, target {WHOLE_MOST_S:g} s on two cores", *commands)
    words = f"naming alone of {STUDY_DRIVES} recordings (a case of the study)"
    print(f"{words:52s} {study_s[0]:6.1f} {study_s[1]:12.1f}, target {STUDY_MOST_S:g} s")


if __name__ == "__main__":
    main()
