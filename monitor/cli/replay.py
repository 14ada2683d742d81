"""``o2mon replay``: judge recorded drives."""

from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import ColumnNames, LogChannel, Output, Quiet
from monitor.base.files.junit import JunitCase, JunitRun, junit_file
from monitor.cli.options import LOGS, JudgeOptions, Unusable, say, set_up, warn, write_outputs
from monitor.cli.sinks import SinkOptions, appended, open_sinks, spoken

__all__ = ["EXAMPLES", "appended", "run"]

EXAMPLES = """examples:
  o2mon replay drive.blf                     log of the project's own ECU, shipped model
  o2mon replay *.log --html report.html      several drives, shown on a web page
  o2mon replay drive.log --dbc engine.dbc --map engine.toml --model mine.onnx
  o2mon replay drive.msl --model mine.onnx   log of TunerStudio, COBB, Torque and others
  o2mon replay table.csv --model mine.onnx --columns names.toml

exit code: 0 judged and no fault, 1 a fault code is pending or confirmed, 2 unusable input,
3 not judged, 4 internal error"""


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(JudgeOptions, ColumnNames, LogChannel, SinkOptions):
    """Options of a replay.

    windows : print every window
    junit : write JUnit XML for a CI server: one test for each drive
    quiet : print nothing per recording
    """

    log: Annotated[Sequence[Path], paths.recording, "LOG", {"help": LOGS}] = field(kw_only=False)
    windows: bool = False
    junit: Output = None
    quiet: Quiet = False


def run(args: ReplayOptions) -> int:
    """Judge recorded drives."""
    with junit_file(args.junit, "o2mon.replay") as tests:
        return _replay(args, tests)


def _replay(args: ReplayOptions, tests: JunitRun) -> int:
    from monitor.frames.text.python_can import import_cantools_alone

    import_cantools_alone()
    from monitor.memory.store import Memory
    from monitor.pipeline.replay import exit_code, replay
    from monitor.report.lines import case, print_recording
    from monitor.sinks.written import Written

    setup = set_up(args, args.columns)
    memory = Memory(args.memory, hold=True) if args.memory else None
    if memory and memory.condition.says:
        warn(memory.condition.says)
    recordings, traces, unusable = [], [], Unusable()
    with (
        closing(memory) if memory else nullcontext(),
        closing(Written(open_sinks(args), args.sink_rate)) as sinks,
    ):
        listeners = sinks.listener if args.sink else None
        for log in args.log:
            tests.name = str(log)
            with unusable.set_aside(log):
                recording, trace = replay(
                    log, setup, memory, trace=bool(args.html), listeners=listeners
                )
                recordings.append(recording)
                traces.append(trace)
                tests.cases.append(case(recording))
                if args.sink and "limits" not in recording:
                    warn(f"{log}: is judged without a model, so the sinks get nothing of it")
                for line in () if args.quiet else print_recording(recording, windows=args.windows):
                    say(line, spoken(args))
            if memory and unusable:  # its driving cycle would be missing in all that follow
                break
    if recordings:
        write_outputs(args, setup, recordings, traces, stream=spoken(args))
    *others, tests.name = unusable or [tests.name]
    tests.cases += [JunitCase(name, "", unusable[name], is_error=True) for name in others]
    unusable.end()
    return exit_code(recordings)
