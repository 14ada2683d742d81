"""A challenge of the gap study: recordings for anyone, the truth sealed by its hash, and marks.

The folder names neither seed nor vehicle, because the simulation is public and both would tell the
truth. The truth holds a random text, so that its hash tells nothing before the file is published.
"""

import hashlib
import json
import secrets
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.workflow import answers, drive
from benchmarks.studies.workflow.plan import Case, Study, cases, healthy_parts
from monitor.base.errors import UsageError
from monitor.base.files.outputs import write_text
from training.limits.rates import Figures, rate
from training.recordings.recording import Recording, write_table

SCHEMA: Final = "o2train.gap-challenge/1"
TRUTH, INDEX, TEMPLATE = "truth.json", "challenge.json", "answers.json"
VERDICTS: Final = ("named", "no_gap", "ambiguous", "unknown_effect", answers.SUSPECTED)
SECRET: Final = 10**9  # seeds and vehicles are drawn below it
NOTE: Final = (
    "Simulated. For every case give verdict (named, no_gap, ambiguous, unknown_effect, "
    "sensor_fault_suspected) and names: the effects named, or the ambiguous set."
)


def secret(study: Study) -> Study:
    """Return the study with vehicles and seeds that nobody can guess."""
    return replace(study, seed=secrets.randbelow(SECRET), first_vehicle=secrets.randbelow(SECRET))


def export(study: Study, folder: Path, truth: Path, done: Callable[[int], object]) -> str:
    """Write the recordings and the sealed truth; return the truth's sha256.

    folder : gets a folder of healthy recordings per vehicle, one of recordings per case, the index
        and a form for answers
    truth : file to be kept until all answers are in
    done : called with 1 after every case and vehicle
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
        done(1)
    names = [f"case_{i:04d}" for i in range(1, len(planned) + 1)]
    for case, name in zip(planned, names, strict=True):
        _write(drive.recordings(case, study.duration_s), folder / name)
        done(1)
    sealed = {
        "schema": SCHEMA,
        "secret": secrets.token_hex(32),
        "study": asdict(study),
        "cases": {name: _truth(case) for case, name in zip(planned, names, strict=True)},
    }
    text = json.dumps(sealed, indent=1) + "\n"
    write_text(truth, text)
    digest = _sha256(text)
    index = {
        "schema": SCHEMA,
        "note": NOTE,
        "truth_sha256": digest,
        "cases": {name: numbers[case.vehicle] for case, name in zip(planned, names, strict=True)},
    }
    write_text(folder / INDEX, json.dumps(index, indent=1) + "\n")
    form = {name: {"verdict": "", "names": []} for name in names}
    write_text(folder / TEMPLATE, json.dumps(form, indent=1) + "\n")
    return digest


def score(given: Path, truth: Path, folder: Path | None = None) -> dict[str, Figures]:
    """Return the marks of anyone's answers: how many are right, of each kind of case.

    A case without an answer counts as not right. An effect is right if it is named, ``among`` also
    if it stands in the ambiguous set.
    folder : of the challenge, whose hash the truth must have
    Raises UsageError if a file is none of a challenge, or if the truth is not the sealed one.
    """
    text = _read(truth)
    if folder is not None and _sha256(text) != _tree(folder / INDEX).get("truth_sha256"):
        raise UsageError(f"{truth}: not the truth that was sealed in {folder / INDEX}")
    hidden, answered = _tree(truth).get("cases"), _tree(given)
    if not isinstance(hidden, dict):
        raise UsageError(f"{truth}: no truth of a challenge")
    strange = sorted(set(answered) - set(hidden))
    if strange:
        raise UsageError(f"{given}: no such case: {', '.join(strange[:3])}")
    rows = [case | _answer(answered.get(name, {}), given, name) for name, case in hidden.items()]
    marks: dict[str, Figures] = {}
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        for what, is_right in _RIGHT[kind].items():
            marks[f"{kind}: {what}"] = rate(sum(map(is_right, own)), len(own))
    named = [row for row in rows if row["names"]]
    marks["names that are right"] = rate(sum(map(answers.right, named)), len(named))
    return marks


def as_text(marks: Mapping[str, Figures]) -> str:
    """Return the marks as lines, each with its 95 % bounds.

    >>> print(as_text({"null: no gap": rate(9, 10)}))
    null: no gap: 9 of 10 (55.5 to 99.7 %)
    """
    return "\n".join(
        f"{what}: {m['events']} of {m['trials']}"
        + (f" ({100 * m['low']:.1f} to {100 * m['high']:.1f} %)" if m["trials"] else "")
        for what, m in marks.items()
    )


Row = dict[str, Any]
_EFFECT: Final[Mapping[str, Callable[[Row], bool]]] = {
    "named rightly": answers.right,
    "right or among the ambiguous": answers.right_or_among,
}
_SUSPECTED: Final[Mapping[str, Callable[[Row], bool]]] = {
    "suspected": lambda row: row["verdict"] == answers.SUSPECTED
}
_RIGHT: Final[Mapping[str, Mapping[str, Callable[[Row], bool]]]] = {
    "effect": _EFFECT,
    "two": _EFFECT,
    "null": {"no gap": lambda row: row["verdict"] == "no_gap"},
    "unknown": {"unknown": lambda row: row["verdict"] == "unknown_effect"},
    "onset": _SUSPECTED,
    "fault": _SUSPECTED,
}


def _truth(case: Case) -> Row:
    return {k: v for k, v in case.as_row().items() if k != "number"}


def _answer(given: Any, path: Path, name: str) -> Row:
    verdict = given.get("verdict", "") if isinstance(given, dict) else None
    names = given.get("names", []) if isinstance(given, dict) else None
    if verdict not in (*VERDICTS, "") or not isinstance(names, list):
        raise UsageError(f"{path}: {name}: verdict is one of {', '.join(VERDICTS)}, names a list")
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


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot read it: {error}") from error


def _tree(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(_read(path))
    except json.JSONDecodeError as error:
        raise UsageError(f"{path}: no JSON: {error}") from error
    if not isinstance(found, dict):
        raise UsageError(f"{path}: an object is wanted")
    return found
