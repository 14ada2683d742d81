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
from training.limits.data_check.check import check
from training.limits.data_check.findings import verdict
from training.recordings.preparation import ENABLE_COLUMNS
from training.study.narx import study as narx_study
from training.study.outcome.choice import choose, contenders, free_structure
from training.study.outcome.comparison import TITLES, baselines, beside
from training.study.outcome.sensor import against_sensor
from training.study.outcome.shipment import ship
from training.study.outcome.steady_training import steady_against_mixed
from training.study.preparation.preparation import preparation
from training.study.selection.selection import selection
from training.study.study_page import report
from training.study.task import Task, source

SCHEMA = "o2train.study/1"
VERSION = 3  # of the parts' content; stored parts of another version are not reused
PRIVATE = ("weights", "one_step_weights")  # only in the part's file, not in study.json
FALSE_ALARMS = 2.0  # percent of healthy windows, two limits at quantiles of 1 %
SELECTION_SHARE = 0.4  # of the study's budget

Parts = dict[str, Any]
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Step:
    """One part of the study: name in study.json, title and dependencies."""

    name: str
    title: str
    compute: Callable[[Task, Parts], dict[str, Any]]
    uses: tuple[str, ...] = ()  # earlier parts; a change in one computes this part again
    whole: bool = False  # True: depends also on held-out, faulty and steady recordings
    skips: tuple[type[Exception], ...] = ()  # errors that leave the part out; the text is kept


def study(task: Task, say: Say) -> dict[str, Any]:
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
        parts[step.name], stored = _done(task, step, parts)
        skipped = parts[step.name].get("skipped")
        how = "as stored" if stored else f"{parts[step.name]['part_seconds']:.0f} s"
        say(f"    left out: {skipped}" if skipped else f"    {how}")
    warnings = _warnings(parts)
    result = {
        "schema": SCHEMA,
        "version": __version__,
        "model": "model.onnx",
        "warnings": warnings,
        "seconds": round(time.monotonic() - began, 1),
        **parts,
    }
    result["free"] = {k: v for k, v in parts["free"].items() if k not in PRIVATE}
    write_text(task.out / "study.json", json.dumps(result, allow_nan=False) + "\n")
    write_text(task.out / "report.html", report(parts, warnings))
    return result


def _done(task: Task, step: Step, parts: Parts) -> tuple[dict[str, Any], bool]:
    """Return the step's result, and whether it was read from its file."""
    path = task.folder / f"{step.name}.json"
    key = _key(task, step, parts)
    try:
        found = json.loads(path.read_text())
        if found["key"] == key and _complete(task, step):
            return found["result"], True
    except (OSError, ValueError, KeyError, TypeError):
        pass
    began, cpu = time.monotonic(), time.process_time()
    try:
        result = step.compute(task, parts)
    except step.skips as error:
        result = {"skipped": str(error)}
    result = {
        **result,
        "part_seconds": round(time.monotonic() - began, 1),
        "part_cpu_s": round(time.process_time() - cpu, 1),
    }
    write_text(path, json.dumps({"key": key, "result": result}, allow_nan=False))
    return result, False


def _key(task: Task, step: Step, parts: Parts) -> str:
    seed = f"{VERSION} {__version__} {step.name} {task.digest(whole=step.whole)}"
    earlier = json.dumps([parts[name] for name in step.uses])
    return hashlib.sha256((seed + earlier).encode()).hexdigest()


def _complete(task: Task, step: Step) -> bool:
    """Return whether the files of a stored part still exist."""
    wanted = {"shipped": task.out / "model.onnx", "narx": task.folder / "narx"}
    return step.name not in wanted or wanted[step.name].exists()


def _data(task: Task) -> dict[str, Any]:
    uses = {
        "train, choose": task.recordings,
        "held-out recording": task.test,
        "faulty recording": task.faulty,
        "steady driving": task.steady,
    }
    return {
        "inputs": list(task.inputs),
        "output": task.output,
        "period_s": task.recordings[0].period_ns / 1e9,
        "samples": sum(len(r.t_s) for r in task.recordings),
        "source": source(task.recordings),
        "conditions": [n for n in ENABLE_COLUMNS if all(n in r.names for r in task.recordings)],
        "recordings": [
            {
                "use": use,
                "path": Path(r.path).name,
                "sha256": r.sha256,
                "samples": len(r.t_s),
                "source": source([r]),
            }
            for use, each in uses.items()
            for r in each
        ],
    }


def _check(task: Task, _: Parts) -> dict[str, Any]:
    """Return the data check; raises RecordingError if the recordings cannot be used."""
    result = check(task.recordings, task.inputs, task.output)
    if not result["usable"]:
        first = next(f["text"] for f in result["findings"] if f["level"] == "error")
        raise RecordingError(f"{verdict(result)}; the first: {first}")
    return result


def _preparation(task: Task, _: Parts) -> dict[str, Any]:
    return preparation(task.recordings, task.inputs, task.output)


def _selection(task: Task, _: Parts) -> dict[str, Any]:
    settings = task.settings
    return selection(
        task.recordings,
        task.inputs,
        task.output,
        seed=settings.seed,
        budget_minutes=SELECTION_SHARE * settings.budget_minutes,
    )


def _linear(task: Task, parts: Parts) -> dict[str, Any]:
    return baselines(task, parts["preparation"]["band_hz"])


def _narx(task: Task, _: Parts) -> dict[str, Any]:
    settings = task.settings
    return narx_study.narx_study(
        task.data,
        task.folder / "narx",
        starts=settings.starts,
        iterations=settings.iterations,
        n_samples=settings.n_samples,
        seed=settings.seed,
        jobs=task.jobs,
        scheduler=task.scheduler,
        candidates=task.models,
    )


def _free(task: Task, _: Parts) -> dict[str, Any]:
    return free_structure(task)


def _choice(task: Task, parts: Parts) -> dict[str, Any]:
    result = choose(task, contenders(task, parts["narx"], parts["free"]))
    return result | {"output": task.output}


def _shipped(task: Task, parts: Parts) -> dict[str, Any]:
    return ship(task, _chosen(task, parts), parts["preparation"].get("linear"))


def _chosen(task: Task, parts: Parts) -> Any:
    return contenders(task, parts["narx"], parts["free"])[parts["choice"]["chosen"]]


def _beside(task: Task, parts: Parts) -> dict[str, Any]:
    if "skipped" in parts["linear"]:
        return {"skipped": "no linear baselines"}
    chosen = _chosen(task, parts)
    return beside(task, parts["linear"], chosen.spec, chosen.weights)


def _sensor(task: Task, parts: Parts) -> dict[str, Any]:
    chosen, shipped = _chosen(task, parts), parts["shipped"]
    result = against_sensor(task, chosen.spec, chosen.weights, shipped["limits"])
    return result | {"bounded": shipped["bounded"]}


def _steady(task: Task, _: Parts) -> dict[str, Any]:
    return steady_against_mixed(task)


STEPS = (
    Step("check", "is the data enough?", _check),
    Step("preparation", "outliers, spectra, trends", _preparation),
    Step("selection", "input selection", _selection, skips=(RecordingError, UsageError)),
    Step(
        "linear", "linear baselines", _linear, ("preparation",), whole=True, skips=(RecordingError,)
    ),
    Step("narx", "NARX study", _narx, skips=(RecordingError,)),
    Step("free", "memory and size chosen by the data", _free, skips=(RecordingError, UsageError)),
    Step("choice", "choice", _choice, ("narx", "free"), whole=True),
    Step("shipped", "model file and limits", _shipped, ("preparation", "choice"), whole=True),
    Step("beside", "beside linear models", _beside, ("linear", "choice"), whole=True),
    Step(
        "sensor",
        "model against sensor, healthy and faulty",
        _sensor,
        ("choice", "shipped"),
        whole=True,
    ),
    Step("steady", "steady training, transient use", _steady, whole=True, skips=(RecordingError,)),
)


def _warnings(parts: Mapping[str, Any]) -> list[str]:
    """Return the warnings at the top of the report."""
    found = [f["text"] for f in parts["check"]["findings"] if f["level"] == "warning"]
    found += parts["narx"].get("warnings", [])
    found += [
        f"free structure: {w}" for w in parts["free"].get("warnings", []) if "histories" not in w
    ]
    found += parts["shipped"]["warnings"]
    for step in STEPS:
        if "skipped" in parts[step.name]:
            found.append(f"{step.title}: left out, {parts[step.name]['skipped']}")
    found += _poor(parts)
    return list(dict.fromkeys(found))


def _poor(parts: Mapping[str, Any]) -> list[str]:
    """Return the warnings about the chosen model."""
    found = []
    candidate = parts["choice"]["candidates"][parts["choice"]["chosen"]]
    fit = candidate["after"]["all"].get("fit_percent")
    if fit is None or fit <= 0.0:
        found.append("the chosen model predicts held-out samples no better than their mean would")
    sensor = parts["sensor"]
    false = 100 * sensor["healthy"]["beyond"]["both"]
    if false > FALSE_ALARMS:
        found.append(
            f"the paper's rule fires in {false:.1f} % of the windows of {sensor['healthy_on']} "
            "without a fault: the limits rest on other driving or weather than these"
        )
    if stuck := parts["sensor"]["bounded"]["stuck"]:
        runs = parts["sensor"]["bounded"]["runs"]
        found.append(
            f"{stuck} of {runs} free runs from random histories stay at an end of the "
            "output's range"
        )
    beside_linear = parts["beside"]
    if "skipped" not in beside_linear:
        own = beside_linear["narx"]["fit_percent"]
        best = beside_linear["models"][beside_linear["best_linear"]]["fit_percent"]
        if own is not None and best is not None and own <= best:
            found.append(
                f"the chosen NARX reaches {own:.1f} % fit on held-out samples, the linear model "
                f"{TITLES[beside_linear['best_linear']]} {best:.1f} %: the NARX is not worth it"
            )
    return found
