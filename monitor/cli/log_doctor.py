"""``o2mon doctor LOG…``: the commands of a diagnosis one after the other, and one page.

The steps run as programs of their own, because the runtime knows nothing of ``o2train``; where its
libraries are not installed, it says so, and the electrical tests need no model of the car.
"""

import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from monitor.base.command_line.parameters import reading_words
from monitor.base.errors import UsageError
from monitor.cli.options import NOT_JUDGED, JudgeOptions, Unusable, say, set_up, write_outputs
from monitor.grid.tables import kinds_of

if TYPE_CHECKING:
    from monitor.cli.doctor import DoctorOptions

Words = list[str | Path]
_MODULES = {"o2mon": "monitor.cli", "o2train": "training.cli"}


def diagnosed(args: "DoctorOptions") -> int:
    """Fit a model or take one, check the logs, judge, estimate tables; return the exit code."""
    from monitor.pipeline.replay import exit_code, replay
    from monitor.report.lines import print_recording

    args.out.mkdir(parents=True, exist_ok=True)
    model, force = args.model, ["--force"] if args.bus.force else []
    steps: dict[str, str] = {}
    if args.healthy and model is None:
        model = args.out / "car.onnx"
        words: Words = [*args.healthy, "--out", model, "--budget", f"{args.budget:g}"]
        words += [*_reading(args, args.healthy), *force]
        steps |= _step("o2train", "fit", *words)
    elif model is None:
        say("no --healthy logs, no --model: the shipped model judges, or electrical tests alone")
    of_model: Words = ["--model", model] if model else []
    settings: Words = ["--config", args.config] if args.config else []
    for log in args.log:
        words = [log, *of_model, *_reading(args, [log]), *settings]
        steps |= _step("o2mon", "check", *words, may_fail=True)
    setup = set_up(replace(args, model=model), args.columns)
    judged, unusable = [], Unusable()
    for log in args.log:
        with unusable.set_aside(log):
            judged.append(replay(log, setup, trace=True))
    logs = args.healthy or [log for log in args.log if str(log) not in unusable] or args.log
    words = [*logs, "--out", args.out / "tables", *_reading(args, logs), *force]
    steps |= _step("o2train", "tables", *words, may_fail=True)
    recordings, traces = [each for each, _ in judged], [trace for _, trace in judged]
    for recording in recordings:
        say("\n".join(print_recording(recording)))
    if recordings:
        write_outputs(JudgeOptions(html=args.out / "report.html"), setup, recordings, traces, steps)
    unusable.end()
    return exit_code(recordings)


def _reading(args: "DoctorOptions", logs: Sequence[Path]) -> Words:
    """Return the options that say how to read these logs."""
    kinds = {kind for log in logs for kind in kinds_of(log)}
    return [*reading_words(kinds, args.pairs, args.columns, getattr(args.bus, "channel", ""))]


def _step(program: str, *words: str | Path, may_fail: bool = False) -> dict[str, str]:
    """Run a command and print it and what it says; return both.

    may_fail : its errors are a part of what it says
    Raises UsageError if it fails, behind its own message.
    """
    name, said = shlex.join([program, *map(str, words)]), ""
    call = [sys.executable, "-m", _MODULES[program], *map(str, words)]
    errors = subprocess.STDOUT if may_fail else None
    say(f"$ {name}")
    with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=errors, text=True) as running:
        for line in running.stdout or ():
            said += line
            say(f"  {line.rstrip()}")
    if running.returncode not in (0, NOT_JUDGED) and not may_fail:
        raise UsageError(f"the step failed: {name}")
    return {name: said}
