"""Verdicts of the monitor on runs of a Bosch engine that neither trained its model nor chose it.

Every run is judged whole: as it is, and with each response fault put on the measured lambda
afterwards (see bosch.py). Engine 1 is split in two: the model of each half is judged on the other.
The response rule's constants were chosen on runs 10, 13, 32, 33, 53 and 54 (``1a``) with a model of
runs 10 to 15, 30 and 31; three later choices were made on the others (``1b``), too. Engine 2 has
six runs, all of which were looked at; each is judged by a model of others. Offsets are put on
engine 1 alone. On engine 2 the recorded lambda stands still for up to 42 s, exact in all digits,
which the plausibility test calls stuck; codes of other tests are counted apart.

python -m benchmarks bosch_verdicts SPLIT [--folder FOLDER] [--model MODEL] [--budget MINUTES]
    [--faults NAME ...] [--offset LAMBDA]

SPLIT is 1a, 1b, 2a, 2b or 2c, or 1:RUN,RUN... or 2:RUN,RUN..., in which these runs train and all
others are judged. FOLDER holds the folders of the engines.
"""

import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.verdicts.bosch import INPUTS, MASK, OUTPUT, RUNS, faulty, path_of, run_of
from monitor.base import config, faults
from monitor.judge.limits import Limits
from monitor.judge.trust import Trust
from monitor.model.step import Model
from training import cli
from training.limits.judging import Judged, judge_recordings
from training.recordings import metrics
from training.recordings.recording import Recording

FAULTS: Final = (
    ("delay_symmetric", 0.4),
    ("delay_rich_to_lean", 0.4),
    ("delay_lean_to_rich", 0.4),
    ("slow_symmetric", 0.6),
    ("slow_rich_to_lean", 0.6),
    ("slow_lean_to_rich", 0.6),
    ("transient", 0.6),
    ("gain_low", 0.6),
)
OFFSETS: Final = ("biased_lean", "biased_rich")  # engine 1 alone
ONE_CLASS: Final = ("slow_symmetric", "transient")
FAILS: Final = 2  # windows in a row that decide


@dataclass(frozen=True, slots=True)
class Split:
    """Which runs of an engine train a model; it is judged on all others."""

    engine: int
    training: tuple[int, ...]

    @property
    def test(self) -> tuple[int, ...]:
        """Return the runs that are judged."""
        return tuple(n for n in RUNS[self.engine] if n not in self.training)

    def faults(self, offset: float) -> tuple[tuple[str, float], ...]:
        """Return name and severity of each fault that is put on.

        offset : in lambda
        """
        return (*FAULTS, *((name, offset) for name in OFFSETS if self.engine == 1))


SPLITS: Final = {
    "1a": Split(1, (11, 12, 14, 15, 30, 31)),
    "1b": Split(1, (10, 13, 32, 33, 53, 54)),
    "2a": Split(2, (3, 6, 8, 11)),
    "2b": Split(2, (8, 11, 15, 19)),
    "2c": Split(2, (3, 6, 15, 19)),
}


def split_of(name: str) -> Split:
    """Return the split of this name.

    Raises ValueError for an unknown one.
    """
    if name in SPLITS:
        return SPLITS[name]
    engine, _, listed = name.partition(":")
    training = tuple(int(run) for run in listed.split(","))
    if not set(RUNS[int(engine)]) >= set(training):
        raise ValueError(f"{name}: wanted {', '.join(SPLITS)} or ENGINE:RUN,RUN...")
    return Split(int(engine), training)


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """What the monitor said of one drive."""

    fault: str  # "" for a healthy one
    named: str  # by a code of one of the faults put on, "" without one
    beside: str  # other codes
    sound_first: bool  # the sensor was called sound before any code
    sound: bool


def verdict(fault: str, judged: Judged, names: Collection[str]) -> RunVerdict:
    """Return the verdict on a drive.

    names : of the faults that are put on
    """
    outcomes = [w.outcome for w in judged.windows]
    passed = _nth_in_a_row(outcomes, "passed", FAILS)
    own = [d for d in judged.dtcs if d.fault in names]
    beside = " ".join(d.fault for d in judged.dtcs if d.fault not in names)
    failed = min((d.t_ns for d in own), default=None)
    ends = [w.window.t_end_ns for w in judged.windows]
    sound = passed is not None
    first = sound and (failed is None or ends[passed or 0] < failed)
    return RunVerdict(fault, own[-1].fault if own else "", beside, first, sound)


def _nth_in_a_row(outcomes: Sequence[str], wanted: str, n: int) -> int | None:
    row = 0
    for i, outcome in enumerate(outcomes):
        row = row + 1 if outcome == wanted else 0 if outcome != "inconclusive" else row
        if row == n:
            return i
    return None


def drives(
    recording: Recording, put_on: Sequence[tuple[str, float]] = FAULTS
) -> list[tuple[str, Recording]]:
    """Return the run as it is and with every one of the faults put on."""
    column, period_s = recording.names.index(OUTPUT), recording.period_ns / 1e9
    found = [("", recording)]
    for name, severity in put_on:
        values = recording.values.copy()
        values[:, column] = faulty(values[:, column], faults.resolve(name, severity), period_s)
        found.append((name, replace(recording, values=values)))
    return found


def fit(folder: Path, split: Split, columns: Path | None, budget: str, path: Path) -> None:
    """Fit the split's model with all defaults, and its limits."""
    runs = [str(path_of(folder, split.engine, n)) for n in split.training]
    mask = ["--columns", str(columns)] if columns else []
    used = [*mask, "--output", OUTPUT, "--budget", budget, "--out", str(path)]
    for inputs in (INPUTS, INPUTS[:-1])[split.engine - 1 :]:  # some runs have no fuel cut
        if cli.main(["fit", *runs, *used, "--inputs", *inputs]) == 0:
            return


@contextmanager
def model_of(
    folder: Path, split: Split, given: Path | None, budget: str
) -> Iterator[tuple[Path, Path | None]]:
    """Give the model's file, fitted to the split unless one is given, and the columns' map."""
    with tempfile.TemporaryDirectory() as name:
        columns = Path(name) / "columns.toml" if split.engine == 1 else None
        if columns:
            columns.write_text(MASK)
        path = given or Path(name) / "bosch.onnx"
        if not given:
            fit(folder, split, columns, budget, path)
        yield path, columns


def rows_of(split: str, verdicts: Sequence[RunVerdict], trust: Trust) -> Iterator[Row]:
    """Yield a row for the healthy runs, for each fault and for all of them.

    trust : of the model, which says before which faults it will find
    """
    totals: Counter[str] = Counter()
    for fault in dict.fromkeys(v.fault for v in verdicts):
        own = [v for v in verdicts if v.fault == fault]
        alike = ONE_CLASS if fault in ONE_CLASS else (fault,)
        count = {
            "of": len(own),
            "found": sum(bool(v.named) for v in own),
            "named": sum(v.named == fault for v in own if fault),
            "named, class": sum(v.named in alike for v in own if fault),
            "called sound": sum(v.sound for v in own),
            "sound first": sum(v.sound_first for v in own),
            "codes of other tests": sum(bool(v.beside) for v in own),
        }
        names = Counter(v.named for v in own if v.named)
        told = ", ".join(f"{n} {k}" for n, k in names.items())
        count["says it is tested"] = fault in (trust.found or {}) and fault not in trust.untested
        yield {"split": split, "fault": fault or "healthy"} | count | {"names": told}
        totals.update(count if fault else {})
    yield {"split": split, "fault": "all faults"} | dict(totals) | {"names": ""}


def main(argv: Sequence[str]) -> int:
    """Fit unless a model is given, then judge the runs left out."""
    smallest = {"faults": ["gain_low"], "budget": "0.02", "runs": 1}
    options = BenchmarkOptions(__name__, __doc__, **smallest)
    names = [*(name for name, _ in FAULTS), *OFFSETS]
    options.add_argument("split", help="1a, 1b, 2a, 2b, 2c or ENGINE:RUN,RUN...")
    options.add_argument("--folder", type=Path, default=Path("../shared/data"))
    options.add_argument("--faults", nargs="+", choices=names, default=names)
    options.add_argument("--offset", type=float, default=0.1, metavar="LAMBDA")
    options.add_argument("--model", type=Path)
    options.add_argument("--budget", default="8")
    options.add_argument("--runs", type=int, help="judge only the first so many")
    args = options.parse_args(argv)
    split, settings = split_of(args.split), config.load()
    every, verdicts = split.faults(args.offset), list[RunVerdict]()
    put_on, told = [each for each in every if each[0] in args.faults], {name for name, _ in every}
    with model_of(args.folder, split, args.model, args.budget) as (path, columns):
        model = Model.load(path)
        limits = Limits.from_card(model.card, settings, str(path))
        for run in split.test[: args.runs]:
            cases = drives(run_of(args.folder, split.engine, run, columns), put_on)
            judged = judge_recordings([r for _, r in cases], model, limits, settings)
            on = judged[0].enabled & np.isfinite(judged[0].predicted)
            share = metrics.fit_percent(cases[0][1].column(OUTPUT)[on], judged[0].predicted[on])
            pairs = zip(cases, judged, strict=True)
            own = [verdict(fault, each, told) for (fault, _), each in pairs]
            said = " ".join(v.named or ("SOUND" if v.sound_first else "-") for v in own)
            say(f"run {run}: fit {share:.0f} %, {on.sum()} samples: {said}")
            verdicts += own
    return finish(args, list(rows_of(args.split, verdicts, limits.trust)))
