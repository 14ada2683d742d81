"""Verdicts of the monitor on runs of a Bosch engine that neither trained its model nor chose it.

Real recordings (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0; 10 Hz, z-scored by their
authors). Every run is judged whole: as it is, and with each response fault put on the measured
lambda afterwards, which the control loop did not see. Engine 1 is split in two: the model of each
half is judged on the other. The response rule's constants were chosen on runs 10, 13, 32, 33, 53
and 54 (``1a``) with a model of runs 10 to 15, 30 and 31; three later choices were made on the
others (``1b``), too. Engine 2 has six runs, all of which were looked at; each is judged by a model
of others.

Gains act around z = -0.065. Offsets are put on engine 1 alone, since engine 2's scale is not
published. On engine 2 the recorded lambda stands still for up to 42 s, exact in all digits, which
the plausibility test calls stuck; codes of other faults than those put on are counted apart.

    python -m benchmarks bosch_verdicts FOLDER SPLIT [--model MODEL] [--budget MINUTES]
        [--faults NAME…] [--offset LAMBDA] [--nearer SHARE]

FOLDER holds the runs of the engine; SPLIT is 1a, 1b, 2a, 2b or 2c, or 1:RUN,RUN… or 2:RUN,RUN…, in
which these runs train and all others are judged. ``--nearer`` asks how good a model would have to
be: every reading is moved towards its prediction by this share of the residual, and limits stay.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.verdicts.bosch import INPUTS, MASK, OUTPUT, faulty
from monitor.base import config, faults
from monitor.base.config import Config
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.model.step import Model
from training import cli
from training.limits.judging import Judged, judge_recordings
from training.recordings import metrics
from training.recordings.recording import Recording, load

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


@dataclass(frozen=True, slots=True)
class Split:
    """Which runs train a model, and which it is judged on."""

    training: tuple[int, ...]
    test: tuple[int, ...]
    has_cut: bool  # engine 1: the channel of the fuel cut and the scale of lambda are published

    def faults(self, offset: float) -> tuple[tuple[str, float], ...]:
        """Return name and severity of each fault that is put on.

        offset : in lambda
        """
        offsets = tuple((name, offset) for name in OFFSETS)
        return (*FAULTS, *offsets) if self.has_cut else FAULTS


SPLITS: Final = {
    "1a": Split((11, 12, 14, 15, 30, 31), (10, 13, 32, 33, 53, 54), has_cut=True),
    "1b": Split((10, 13, 32, 33, 53, 54), (11, 12, 14, 15, 30, 31), has_cut=True),
    "2a": Split((3, 6, 8, 11), (15, 19), has_cut=False),
    "2b": Split((8, 11, 15, 19), (3, 6), has_cut=False),
    "2c": Split((3, 6, 15, 19), (8, 11), has_cut=False),
}


def split_of(name: str) -> Split:
    """Return the split of this name.

    Raises ValueError for an unknown one.
    """
    if name in SPLITS:
        return SPLITS[name]
    engine, _, listed = name.partition(":")
    runs = {str(n): n for key, split in SPLITS.items() if key[0] == engine for n in split.test}
    training = listed.split(",")
    if not runs.keys() >= set(training):
        raise ValueError(f"{name}: wanted {', '.join(SPLITS)} or ENGINE:RUN,RUN…")
    test = tuple(sorted(n for key, n in runs.items() if key not in training))
    return Split(tuple(runs[key] for key in training), test, has_cut=engine == "1")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the monitor said of one drive."""

    fault: str  # "" for a healthy one
    named: str  # by a code of one of the faults put on, "" without one
    beside: str  # other codes
    sound_first: bool  # the sensor was called sound before any code
    sound: bool


def verdict(fault: str, judged: Judged, names: Collection[str], fails: int) -> Verdict:
    """Return the verdict on a drive.

    names : of the faults that are put on
    fails : windows in a row that decide
    """
    outcomes = [w.outcome for w in judged.windows]
    passed = _nth_in_a_row(outcomes, "passed", fails)
    own = [d for d in judged.dtcs if d.fault in names]
    beside = " ".join(d.fault for d in judged.dtcs if d.fault not in names)
    failed = min((d.t_ns for d in own), default=None)
    ends = [w.window.t_end_ns for w in judged.windows]
    sound = passed is not None
    first = sound and (failed is None or ends[passed or 0] < failed)
    return Verdict(fault, own[-1].fault if own else "", beside, first, sound)


def most_beyond(judged: Judged, settings: Config) -> float:
    """Return by how many standard deviations the offset exceeds its limit at most."""
    told = [w.statistics["offset_beyond"] for w in judged.windows]
    beyond = [each for each in told if isinstance(each, float)]
    return max(beyond[settings.bias.n_windows - 1 :], default=-np.inf)


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
    runs = [str(folder / f"run_{n:06d}.csv.gz") for n in split.training]
    mask = ["--columns", str(columns)] if columns else []
    used = [*mask, "--output", OUTPUT, "--budget", budget, "--out", str(path)]
    for inputs in (INPUTS, INPUTS[:-1])[not split.has_cut :]:  # some runs have no fuel cut
        if cli.main(["fit", *runs, *used, "--inputs", *inputs]) == 0:
            return


def nearer(model: Model, recording: Recording, share: float, settings: Config) -> Recording:
    """Return the recording with the reading moved towards its prediction."""
    unlimited = judge_recordings([recording], model, NO_LIMITS, settings)[0]
    column, values = recording.names.index(OUTPUT), recording.values.copy()
    residual = np.nan_to_num(unlimited.measured - unlimited.predicted)
    values[:, column] -= share * residual
    return replace(recording, values=values)


def table(title: str, verdicts: Sequence[Verdict]) -> None:
    """Print the table of all drives."""
    print(
        f"\n| {title} | found | named | named, class | called sound first | codes of other tests "
        "| names |"
    )
    print("|---|---|---|---|---|---|---|")
    totals: Counter[str] = Counter()
    for fault in dict.fromkeys(v.fault for v in verdicts):
        own = [v for v in verdicts if v.fault == fault]
        alike = ONE_CLASS if fault in ONE_CLASS else (fault,)
        count = {
            "found": sum(bool(v.named) for v in own),
            "named": sum(v.named == fault for v in own if fault),
            "class": sum(v.named in alike for v in own if fault),
            "sound": sum(v.sound_first for v in own),
            "beside": sum(bool(v.beside) for v in own),
        }
        names = ", ".join(f"{n} {k}" for n, k in Counter(v.named for v in own if v.named).items())
        print(_line(fault or "healthy", count, len(own), names))
        if fault:
            totals.update(count)
    n = sum(bool(v.fault) for v in verdicts)
    print(_line("all faults", totals, n, ""))


def _line(title: str, count: dict[str, int], n: int, names: str) -> str:
    cells = (f"{count[key]} of {n}" for key in ("found", "named", "class", "sound", "beside"))
    return f"| {title} | {' | '.join(cells)} | {names or '-'} |"


@contextmanager
def model_of(
    folder: Path, split: Split, given: Path | None, budget: str, *, masks: bool
) -> Iterator[tuple[Path, Path | None]]:
    """Give the model's file, fitted to the split unless one is given, and the columns' map.

    masks : whether fuel cuts are left out
    """
    with tempfile.TemporaryDirectory() as name:
        columns = Path(name) / "columns.toml" if masks else None
        if columns:
            columns.write_text(MASK)
        path = given or Path(name) / "bosch.onnx"
        if not given:
            fit(folder, split, columns, budget, path)
        yield path, columns


def main(argv: Sequence[str]) -> int:
    """Fit unless a model is given, then judge the runs left out."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("split", type=split_of)
    names = [*(name for name, _ in FAULTS), *OFFSETS]
    parser.add_argument("--faults", nargs="+", choices=names, default=names)
    parser.add_argument("--offset", type=float, default=0.1, metavar="LAMBDA")
    parser.add_argument("--model", type=Path)
    parser.add_argument("--budget", default="8")
    parser.add_argument("--nearer", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--no-mask", action="store_true", help="judge fuel cuts as any driving")
    args = parser.parse_args(argv)
    split, settings = args.split, config.load()
    masks = split.has_cut and not args.no_mask
    with model_of(args.folder, split, args.model, args.budget, masks=masks) as (path, columns):
        model = Model.load(path)

        def recording_of(run: int) -> Recording:
            whole_run = load(args.folder / f"run_{run:06d}.csv.gz", columns=columns)
            return nearer(model, whole_run, args.nearer, settings) if args.nearer else whole_run

        limits = Limits.from_card(model.card, settings, str(path))
        print(
            f"evidence {limits.evidence:.3g}, gain_model {limits.gain_model:.3g}, "
            f"offset {limits.offset_high:.3g}"
        )
        every = split.faults(args.offset)
        put_on = [each for each in every if each[0] in args.faults]
        told, verdicts = {name for name, _ in every}, []
        for run in split.test:
            cases = drives(recording_of(run), put_on)
            judged = judge_recordings([r for _, r in cases], model, limits, settings)
            on = judged[0].enabled & np.isfinite(judged[0].predicted)
            share = metrics.fit_percent(judged[0].measured[on], judged[0].predicted[on])
            own = [
                verdict(fault, each, told, 2)
                for (fault, _), each in zip(cases, judged, strict=True)
            ]
            said = " ".join(v.named or ("SOUND" if v.sound_first else "-") for v in own)
            print(
                f"run {run}: fit {share:.0f} %, {on.sum()} samples, healthy offset at most "
                f"{most_beyond(judged[0], settings):.1f} standard deviations beyond: {said}",
                flush=True,
            )
            verdicts += own
    table(f"trained on {split.training}, {len(split.test)} runs", verdicts)
    return 0
