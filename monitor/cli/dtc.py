"""``o2mon dtc``: show and clear the fault memory."""

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.signature import add_command
from monitor.base.counts import counted, plain
from monitor.base.errors import UsageError
from monitor.base.signals import unit_of
from monitor.cli.options import say, warn

if TYPE_CHECKING:
    from monitor.memory.dtc import Dtc
    from monitor.memory.dtc_store import DtcStore
    from monitor.memory.store import Condition

_EXAMPLES = """examples:
  o2mon dtc list --memory o2.db
  o2mon dtc freeze-frame --memory o2.db P0133
  o2mon dtc readiness --memory o2.db --json
  o2mon dtc clear --memory o2.db

exit code: 0 done, 2 the fault memory cannot be used"""
SCHEMA = "o2mon.dtc/1"


@dataclass(frozen=True, kw_only=True)
class DtcOptions:
    """Options of every action.

    memory : fault memory, written by o2mon run or o2mon replay with --memory
    json : print JSON
    """

    memory: Annotated[Path, paths.kept, "FILE"]
    json: bool = False


def add(parser: argparse.ArgumentParser) -> None:
    """Make the parser that of ``o2mon dtc``, with its actions."""
    parser.description = "Read and clear trouble codes."
    parser.epilog, parser.formatter_class = _EXAMPLES, argparse.RawDescriptionHelpFormatter
    actions = parser.add_subparsers(required=True, metavar="action", dest="action")
    for name, text, action in (
        ("list", "list the trouble codes", _list),
        ("freeze-frame", "show the signals at the time when a code was set", _freeze_frame),
        ("readiness", "show the tests, their results and their in-use performance", _readiness),
        ("clear", "clear everything but permanent codes and in-use performance", _clear),
    ):
        add_command(actions.add_parser(name, help=text), action)


def _check(path: Path) -> None:
    """Raise UsageError if the fault memory does not exist; opening it would create one."""
    from monitor.memory.block import Block

    if Block(path).files[1].exists():
        return
    if not path.exists():
        raise UsageError(f"{path}: no such fault memory")
    if path.is_file() and path.stat().st_size == 0:
        raise UsageError(f"{path}: is empty, a fault memory is wanted")


def _load(path: Path) -> "tuple[DtcStore, Condition]":
    """Return the content of a fault memory, and whether it was damaged."""
    from monitor.memory.dtc_store import DtcStore
    from monitor.memory.store import Memory

    _check(path)
    with closing(Memory(path)) as memory:
        return DtcStore(memory.load()), memory.condition


def _print(
    args: DtcOptions, found: "Condition", fields: Mapping[str, Any], lines: Iterator[str]
) -> int:
    if found.says:
        warn(found.says)
    if args.json:
        memory = {"memory": str(args.memory), "memory_state": found.entry}
        say(json.dumps({"schema": SCHEMA, **memory, **fields}, indent=1))
    else:
        for line in lines:
            say(line)
    return 0


def _list(args: DtcOptions) -> int:
    """List the trouble codes."""
    store, found = _load(args.memory)
    fields = {
        "mil": store.mil,
        "dtcs": [_dtc_fields(dtc) for dtc in store.active],
        "permanent": list(store.permanent),
        "counts": asdict(store.counts),
    }
    return _print(args, found, fields, _list_lines(store))


def _dtc_fields(dtc: "Dtc") -> dict[str, Any]:
    return {
        "code": dtc.code,
        "fault": dtc.fault,
        "also": list(dtc.also),
        "state": dtc.state,
        "status": int(dtc.status),
        "status_bits": [bit.name.lower() for bit in dtc.status if bit.name],
    }


def _list_lines(store: "DtcStore") -> Iterator[str]:
    from monitor.memory.dtc import Status
    from monitor.report.lines import advice_lines

    yield f"lamp {'ON' if store.mil else 'off'}, {counted(len(store.active), 'code')}"
    for dtc in store.active:
        lamp = "lamp" if dtc.status & Status.WARNING_INDICATOR else ""
        fault = " or ".join((dtc.fault, *dtc.also))
        yield f"  {dtc.code}  {dtc.state:<9}  {lamp:<4}  0x{dtc.status:02X}  {fault}"
    yield from advice_lines(map(_dtc_fields, store.active))
    if store.permanent:
        yield f"permanent: {', '.join(store.permanent)}"
    counts = store.counts
    yield (
        f"since clearing: {counted(counts.warm_ups_since_clear, 'warm-up')}, "
        f"{counts.distance_since_clear_km:.1f} km, "
        f"{counts.engine_run_since_clear_s / 3600:.1f} h of engine running"
    )
    yield (
        f"with the lamp on: {counts.distance_with_mil_km:.1f} km, "
        f"{counts.engine_run_with_mil_s / 3600:.1f} h of engine running"
    )
    yield f"in all: {counted(counts.ignition_cycles, 'ignition cycle')}"


def _freeze_frame(code: Annotated[Sequence[str], "CODE"] = (), *, args: DtcOptions) -> int:
    """Show the signals at the time when a code was set.

    code : code (default: all)
    """
    store, found = _load(args.memory)
    frames = store.freeze_frames
    missing = [each for each in code if each not in frames]
    if missing:
        there = ", ".join(frames) or "none"
        raise UsageError(
            f"{args.memory}: no freeze frame of {', '.join(missing)}; there are: {there}"
        )
    chosen = [frame for name, frame in frames.items() if not code or name in code]
    told = [{"code": f.code, "t_ns": f.t_ns, "values": dict(f.values)} for f in chosen]

    def lines() -> Iterator[str]:
        if not chosen:
            yield "no freeze frames"
        for frame in chosen:
            yield f"{frame.code}  {_when(frame.t_ns)}"
            for name, value in frame.values.items():
                yield f"  {name:<28} {plain(value):>10} {unit_of(name)}"

    return _print(args, found, {"freeze_frames": told}, lines())


_EPOCH_FROM_NS = 10**18  # the year 2001; a smaller time counts from the start of a recording


def _when(t_ns: int) -> str:
    if t_ns < _EPOCH_FROM_NS:
        return f"{t_ns / 1e9:.1f} s into the recording"
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(t_ns / 1e9))


def _readiness(args: DtcOptions) -> int:
    """Show the tests, their results and their in-use performance."""
    store, found = _load(args.memory)
    tests = [
        {
            "test": ratio.test,
            "completed_since_clear": store.completed_since_clear(ratio.test),
            "numerator": ratio.numerator,
            "denominator": ratio.denominator,
        }
        for ratio in store.supported_ratios
    ]
    fields = {
        "tests": tests,
        "results": [asdict(result) for result in store.results],
        "general_denominator": store.counts.general_denominator,
        "ignition_cycles": store.counts.ignition_cycles,
    }

    def lines() -> Iterator[str]:
        for ratio in store.supported_ratios:
            done = "complete" if store.completed_since_clear(ratio.test) else "not complete"
            judged = counted(ratio.numerator, "driving cycle")
            yield (
                f"{ratio.test:<18} {done:<13} judged in {judged}, "
                f"{ratio.denominator} were long and warm enough to count"
            )
        for r in store.results:
            inside = "" if r.low <= r.value <= r.high else "  outside"
            limits = f"{plain(r.low)} to {plain(r.high)}{' lambda' * (r.test == 'bias')}"
            yield f"  {r.test:<17} {r.quantity:<28} {plain(r.value):>10}   {limits}{inside}"

    return _print(args, found, fields, lines())


def _clear(args: DtcOptions) -> int:
    """Clear everything but permanent codes and in-use performance."""
    from monitor.memory.dtc_store import DtcStore
    from monitor.memory.store import Memory

    _check(args.memory)
    with closing(Memory(args.memory, hold=True)) as memory:
        store = DtcStore(memory.load())
        cleared = [dtc.code for dtc in store.active]
        store.clear()
        memory.save(store.saved)
        memory.forget_loss()
        found = memory.condition

    def lines() -> Iterator[str]:
        yield f"cleared: {', '.join(cleared) or 'no code was set'}"
        if store.permanent:
            yield (
                f"permanent codes stay: {', '.join(store.permanent)}; each goes after a driving "
                "cycle in which its own test passes"
            )

    fields = {"cleared": cleared, "permanent": list(store.permanent)}
    return _print(args, found, fields, lines())
