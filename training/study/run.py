"""Run of the study: all steps in order, every part stored as soon as it is finished, one page.

The key of a part is made from the recordings' sha256, the settings and the version. A study that
was killed takes finished parts from its folder and runs only the rest.
"""

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.base.errors import RecordingError, UsageError
from monitor.base.files.outputs import write_text
from training.jobs.run_folder import write_json
from training.limits.data_check.check import check
from training.limits.data_check.findings import verdict
from training.recordings.samples.preparation import ENABLE_COLUMNS
from training.study import choice, page
from training.study.baselines import baselines, beside
from training.study.driving.effort import effort
from training.study.driving.steady import steady_against_mixed as steady
from training.study.narx.study import narx_study
from training.study.preparation import preparation
from training.study.results import public, stored
from training.study.selection.selection import selection
from training.study.sensor import against_sensor
from training.study.task import Parts, Task, source

SCHEMA = "o2train.study/1"
VERSION = 9  # of the parts' content; stored parts of another version are not reused
USELESS = (RecordingError, UsageError)


@dataclass(frozen=True, slots=True)
class StudyStep:
    """One part of the study: name in study.json, title and dependencies."""

    name: str
    title: str
    compute: Callable[[Task, Parts], dict[str, Any]]
    uses: str = ""  # names of earlier parts; a change in one computes this part again
    whole: bool = False  # True: depends also on held-out, faulty and steady recordings
    skips: tuple[type[Exception], ...] = ()  # errors that leave the part out; the text is kept


def _check(task: Task, _: Parts) -> dict[str, Any]:
    """Return the data check; raises RecordingError if the recordings cannot be used."""
    result = check(task.recordings, task.inputs, task.output)
    if not result["usable"]:
        first = next(f["text"] for f in result["findings"] if f["level"] == "error")
        raise RecordingError(f"{verdict(result)}; the first: {first}")
    return result


STEPS = (
    StudyStep("check", "is the data enough?", _check),
    StudyStep(
        "preparation",
        "outliers, spectra, trends",
        lambda task, _: preparation(task.recordings, task.inputs, task.output),
    ),
    StudyStep("selection", "input selection", selection, skips=USELESS),
    StudyStep("linear", "linear baselines", baselines, "preparation", whole=True, skips=USELESS),
    StudyStep("narx", "NARX study", narx_study, skips=USELESS),
    StudyStep("free", "memory and size chosen by the data", choice.free_structure, skips=USELESS),
    StudyStep("choice", "choice", choice.choice, "narx free", whole=True),
    StudyStep("shipped", "model file and limits", choice.ship, "choice", whole=True),
    StudyStep("beside", "beside linear models", beside, "linear choice", whole=True),
    StudyStep(
        "sensor", "model against sensor, healthy and faulty", against_sensor, "shipped", True
    ),
    StudyStep("steady", "steady training, transient use", steady, whole=True, skips=USELESS),
    StudyStep("effort", "driving that a calibration takes", effort, whole=True, skips=USELESS),
)


def study(task: Task, say: Callable[[str], None]) -> dict[str, Any]:
    """Run all steps, write study.json, report.html and model.onnx; return study.json's content.

    say : called with a line of text about the progress
    Raises RecordingError or UsageError if the recordings cannot be used.
    """
    task.check()
    task.folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    parts: Parts = {"data": _data(task)}
    for number, step in enumerate(STEPS, 1):
        say(f"{number}/{len(STEPS)} {step.title}")
        parts[step.name], done_before = _done(task, step, parts)
        skipped = parts[step.name].get("skipped")
        how = "as stored" if done_before else f"{parts[step.name]['part_seconds']:.0f} s"
        say(f"    left out: {skipped}" if skipped else f"    {how}")
    warnings = page.warnings(parts, {step.name: step.title for step in STEPS})
    result = {
        "schema": SCHEMA,
        "version": __version__,
        "model": "model.onnx",
        "warnings": warnings,
        "seconds": round(time.monotonic() - began, 1),
        **{name: public(part) for name, part in parts.items()},
    }
    write_json(task.out / "study.json", result)
    write_text(task.out / "report.html", page.report(parts, warnings))
    return result


def _done(task: Task, step: StudyStep, parts: Parts) -> tuple[dict[str, Any], bool]:
    """Return the step's result, and whether it was read from its file."""
    path = task.folder / f"{step.name}.json"
    seed = f"{VERSION} {__version__} {step.name} {task.digest(whole=step.whole)}"
    earlier = json.dumps([parts[name] for name in step.uses.split()])
    key = hashlib.sha256((seed + earlier).encode()).hexdigest()
    found = stored(path)
    if found and found.get("key") == key and all(p.exists() for p in _files(task, found["result"])):
        return found["result"], True
    began = time.monotonic()
    try:
        result = step.compute(task, parts)
    except step.skips as error:
        result = {"skipped": str(error)}
    result["part_seconds"] = round(time.monotonic() - began, 1)
    write_json(path, {"key": key, "result": result})
    return result, False


def _files(task: Task, result: Mapping[str, Any]) -> list[Path]:
    """Return the files that a stored result names: its model, and the jobs of its tuned models."""
    tuned = [each["weights_key"] for each in result.get("tuned", ())]
    keys = [*tuned, *(key.replace("tune", "train") for key in tuned)]
    model = [task.out / result["path"]] if "path" in result else []
    return [*model, *(task.folder / "narx" / f"{key}.json" for key in keys)]


def _data(task: Task) -> dict[str, Any]:
    uses = {
        "train, choose": task.recordings,
        "held-out recording": task.test,
        "faulty recording": task.faulty,
        "steady driving": task.steady,
    }
    rows = [
        {"use": use, "path": Path(r.path).name, "sha256": r.sha256}
        | {"samples": len(r.t_s), "source": source([r])}
        for use, each in uses.items()
        for r in each
    ]
    return {
        "inputs": list(task.inputs),
        "output": task.output,
        "period_s": task.period_s,
        "samples": sum(len(r.t_s) for r in task.recordings),
        "source": source(task.recordings),
        "conditions": [n for n in ENABLE_COLUMNS if all(n in r.names for r in task.recordings)],
        "recordings": rows,
    }
