"""A challenge of the gap study: recordings for anyone, the truth sealed by its hash, and marks.

``--out DIR`` gets recordings of every case and of its healthy vehicle, and the hash of the truth,
which stands beside in DIR-truth.json: keep it until all answers are in. The folder names neither
seed nor vehicle, which are drawn in secret, because the simulation is public and both would tell
the truth. The truth holds a random text, so that its hash tells nothing before it is published.
``--score`` counts the right answers, in the form of the folder's answers.json.

    python -m benchmarks challenge --out set --vehicles 4 --cases effect=20 null=10 fault=5
    python -m benchmarks challenge --out set --score answers.json
"""

import argparse
import hashlib
import json
import secrets
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.options import parser_of, plan_of
from benchmarks.studies.tables import Row, cell, grouped
from benchmarks.studies.workflow import answers, drive
from benchmarks.studies.workflow.plan import Case, Study, cases, healthy_parts
from monitor.base.command_line import command
from monitor.base.command_line import option_paths as paths
from monitor.base.errors import UsageError
from monitor.base.files.outputs import write_text
from training.limits.rates import Figures, rate
from training.recordings.recording import Recording, write_table

TRUTH, INDEX, TEMPLATE = "truth.json", "challenge.json", "answers.json"
VERDICTS: Final = ("named", "no_gap", "ambiguous", "unknown_effect", answers.SUSPECTED)
SECRET: Final = 10**9  # seeds and vehicles are drawn below it
RIGHT: Final = {  # verdict on cases that hide no effect of the library
    "null": "no_gap",
    "unknown": "unknown_effect",
    "onset": answers.SUSPECTED,
    "fault": answers.SUSPECTED,
}
NOTE: Final = (
    "Simulated. For every case give verdict (named, no_gap, ambiguous, unknown_effect, "
    "sensor_fault_suspected) and names: the effects named, or the ambiguous set."
)


def main(argv: list[str]) -> int:
    """Write a challenge or count the right answers; return the exit code."""
    parser = parser_of("challenge", Study, __doc__, _run)
    parser.add_argument("--score", type=paths.read, metavar="ANSWERS", help="count right answers")
    return command.run("challenge", lambda _: parser, argv)


def _run(args: argparse.Namespace) -> int:
    study = plan_of(Study, args)
    truth = args.out.with_name(f"{args.out.name}-{TRUTH}")
    if args.score:
        for each in score(args.score, truth, args.out):
            print(", ".join(f"{name} {cell(value)}" for name, value in each.items()))
        return 0
    drawn = (secrets.randbelow(SECRET) for _ in range(2))
    digest = export(replace(study, seed=next(drawn), first_vehicle=next(drawn)), args.out, truth)
    print(f"challenge: {args.out}\ntruth: {truth}, sha256 {digest}")
    return 0


def export(study: Study, folder: Path, truth: Path) -> str:
    """Write the recordings and the sealed truth; return the truth's sha256.

    folder : gets a folder of healthy recordings per vehicle, one of recordings per case, the index
        and a form for answers
    Raises UsageError if one of them is there already.
    """
    for path in (folder, truth):
        if path.exists():
            raise UsageError(f"{path}: there already; a challenge is written once")
    planned = cases(study)
    numbers = {n: f"vehicle_{i:02d}" for i, n in enumerate(sorted({c.vehicle for c in planned}), 1)}
    for number, name in numbers.items():
        made = drive.healthy(healthy_parts(study, number), number, study.duration_s)
        _write(made, folder / name)
    named = {f"case_{i:04d}": case for i, case in enumerate(planned, 1)}
    for name, case in named.items():
        _write(drive.recordings(case, study.duration_s), folder / name)
    sealed = {
        "secret": secrets.token_hex(32),
        "study": asdict(study),
        "cases": {name: _truth(case) for name, case in named.items()},
    }
    text = json.dumps(sealed, indent=1) + "\n"
    write_text(truth, text)
    digest = _sha256(text)
    index = {
        "note": NOTE,
        "truth_sha256": digest,
        "cases": {name: numbers[case.vehicle] for name, case in named.items()},
    }
    write_text(folder / INDEX, json.dumps(index, indent=1) + "\n")
    form = {name: {"verdict": "", "names": []} for name in named}
    write_text(folder / TEMPLATE, json.dumps(form, indent=1) + "\n")
    return digest


def score(given: Path, truth: Path, folder: Path) -> list[Figures]:
    """Return the marks of anyone's answers: how many are right, of each kind of case.

    A case without an answer counts as not right. An effect is right if it is named, ``among`` also
    if it stands in the ambiguous set.
    folder : of the challenge, whose hash the truth must have
    Raises UsageError if the truth is not the sealed one, or for an answer of no case.
    """
    text = truth.read_text()
    if _sha256(text) != json.loads((folder / INDEX).read_text())["truth_sha256"]:
        raise UsageError(f"{truth}: not the truth that was sealed in {folder / INDEX}")
    hidden, answered = json.loads(text)["cases"], json.loads(given.read_text())
    if strange := sorted(set(answered) - set(hidden)):
        raise UsageError(f"{given}: no such case: {', '.join(strange[:3])}")
    rows = [case | _answer(answered.get(name, {}), given, name) for name, case in hidden.items()]
    return grouped(rows, ("kind",), _marks)


def _marks(own: list[Row]) -> Figures:
    return {
        "right": rate(sum(map(_is_right, own)), len(own)),
        "right or among": rate(
            sum(_is_right(r) or answers.right_or_among(r) for r in own), len(own)
        ),
    }


def _is_right(row: Row) -> bool:
    verdict = RIGHT.get(row["kind"])
    return answers.right(row) if verdict is None else bool(row["verdict"] == verdict)


def _truth(case: Case) -> dict[str, Any]:
    return {k: v for k, v in case.as_row().items() if k != "number"}


def _answer(given: Row, path: Path, name: str) -> dict[str, Any]:
    verdict, names = given.get("verdict", ""), given.get("names", [])
    if verdict not in (*VERDICTS, ""):
        raise UsageError(f"{path}: {name}: verdict is one of {', '.join(VERDICTS)}")
    return {
        "verdict": verdict,
        "names": names if verdict == "named" else [],
        "among": names if verdict == "ambiguous" else [],
        "error": None,
    }


def _write(recordings: list[Recording], folder: Path) -> None:
    folder.mkdir(parents=True)
    for i, each in enumerate(recordings, 1):
        write_table(folder / f"drive_{i:02d}.csv.gz", each.t_s, each.names, each.values)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
