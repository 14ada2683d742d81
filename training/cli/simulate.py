"""The command ``o2train simulate``: write drives of the simulated vehicle as logs or tables."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from monitor.base import faults
from monitor.base.command_line.signature import REPEATED
from monitor.base.errors import UsageError
from training.cli.options import Folder, Length
from training.dyno import downstream, effects

if TYPE_CHECKING:
    from monitor.base.faults import Fault
    from training.dyno.downstream import DownstreamFault
    from training.dyno.engine import EngineLayout

EXAMPLES = """examples:
  o2train simulate --out drives                               healthy WLTC of vehicle 1
  o2train simulate --out drives --cycle udds --seed 7 --format parquet
  o2train simulate --out drives --fault delay_rich_to_lean=0.6 --vehicle 12
  o2train simulate --out drives --fault catalyst_low=0.06     a catalyst that stores 0.06 g
  o2train simulate --out drives --effect wall_film=4 --effect purge=2 --count 20
  o2train simulate --out drives --injection port --metering speed_density --format csv \\
      --period 0.05                                           a tuner's log

All written drives are synthetic. --vehicle fixes the production spread of the vehicle. --seed fixes
driver, noise, weather and whether the engine begins cold. The same command writes the same bytes,
except for the time of writing in .asc and the path in .trc."""
FORMATS = ("log", "blf", "asc", "trc", "mf4", "parquet", "csv", "csv.gz")
_FAULT = {
    "help": f"sensor fault in the control loop: {', '.join(faults.NAMES)}; the unit of the "
    "severity depends on the fault: s (slow, delay), gain or lambda (bias). Behind it: "
    f"{', '.join(downstream.FAULTS)}; g (catalyst_low), s, gain, V (stuck, low, high, "
    "inactive) or part of the power (heater)"
}
_EFFECT = {
    "help": f"effect of the vehicle: {', '.join(effects.NAMES)}; an effect of severity 1 is about "
    "as large as the noise"
}
_KINDS = {"nargs": "?", "const": "switching"}


@dataclass(frozen=True, kw_only=True)
class SimulateCommand:
    """Options of a simulation.

    out : folder for the drives
    vehicle : number of the simulated vehicle
    cycle : wltc_3b, udds, us06, hwfet, micro_trips or steady
    downstream : give the vehicle a catalyst with a sensor behind it, by default one that switches;
        a fault of either does so, too
    active_steps : the ECU tests its catalyst with steps of the commanded mixture by so much, as
        0.03
    fault_start : time at which the fault begins, in seconds
    injection : give the vehicle real injectors and a wall film; a table then holds a tuner's log
    metering : how the ECU of such a vehicle meters air (default: speed_density)
    seed : seed of the first drive
    count : number of drives; every further drive takes the next seed
    duration : end every drive after so many seconds (default: the whole cycle)
    period : period of the sample grid of a table in seconds
    format : file format of the drives
    """

    out: Folder
    vehicle: int = 1
    cycle: str = "wltc_3b"
    fault: Annotated[Sequence[str], REPEATED, "NAME[=SEVERITY]", _FAULT] = ()
    downstream: Annotated[Literal["switching", "wide"] | None, _KINDS] = None
    active_steps: Annotated[float, "PHI"] = 0.0
    fault_start: Length = 0.0
    effect: Annotated[Sequence[str], REPEATED, "NAME=SEVERITY", _EFFECT] = ()
    injection: Literal["port", "direct"] | None = None
    metering: Literal["maf", "speed_density"] | None = None
    seed: int = 1
    count: int = 1
    duration: Length | None = None
    period: Length = 0.1
    format: Annotated[str, {"choices": FORMATS}] = "log"


def run(args: SimulateCommand) -> int:
    """Drive the simulated vehicle on a chassis dynamometer and write one recording per drive.

    Raises UsageError for an impossible option (exit code 2).
    """
    from tqdm import tqdm

    from training.dyno.recording_files import write
    from training.dyno.simulation import Experiment

    _check_needs(args)
    if args.count < 1 or not args.period >= 0.01:
        raise UsageError("--count is at least 1, --period at least 0.01 s")
    if min(args.seed, args.vehicle) < 0:
        raise UsageError("--seed and --vehicle are at least 0")
    if args.duration == float("inf"):
        raise UsageError("--duration inf: a number of seconds is wanted")
    if not 0.0 <= args.active_steps <= 0.1:
        raise UsageError(f"--active-steps {args.active_steps:g}: 0 to 0.1 is wanted")
    fault, downstream_fault = _faults(args.fault)
    if args.downstream == "wide" and downstream_fault and not downstream_fault.suits_wide:
        raise UsageError(
            f"--fault {downstream_fault.name}: only of a downstream sensor that switches"
        )
    hidden = effects.from_severities(dict(map(_severity, args.effect)))
    args.out.mkdir(parents=True, exist_ok=True)
    seeds = range(args.seed, args.seed + args.count)
    for seed in tqdm(seeds, unit="drive", disable=args.count == 1):
        experiment = Experiment(
            cycle=args.cycle,
            vehicle=args.vehicle,
            seed=seed,
            fault=fault,
            fault_start_s=args.fault_start,
            effects=hidden,
            duration_s=args.duration,
            layout=_layout(args),
            downstream=bool(args.downstream or downstream_fault or args.active_steps > 0.0),
            wide_downstream=args.downstream == "wide",
            active_steps_phi=args.active_steps,
            downstream_fault=downstream_fault,
        )
        print(write(experiment, args.out, args.format, args.period))
    return 0


def _faults(texts: Sequence[str]) -> "tuple[Fault | None, DownstreamFault | None]":
    """Return the fault of the sensor, and that behind it; raises UsageError for two behind it."""
    pairs = [_severity(text) if "=" in text else (text, None) for text in texts]
    behind = [pair for pair in pairs if pair[0] in downstream.FAULTS]
    if len(behind) > 1:
        raise UsageError(f"faults {[name for name, _ in behind]}: one behind the sensor is wanted")
    own = [faults.resolve(*pair) for pair in pairs if pair not in behind]
    return combined(own), downstream.fault_behind(*behind[0]) if behind else None


def combined(parts: "Sequence[Fault]") -> "Fault | None":
    """Return one fault with the effects of all parts; None if there are no parts.

    Raises UsageError if two parts set the same parameter.
    """
    if len(parts) < 2:
        return parts[0] if parts else None
    healthy = faults.Fault("", 0.0)
    values: dict[str, Any] = {}
    for part in parts:
        for field in fields(faults.Fault)[2:]:
            value = getattr(part, field.name)
            changed = value != getattr(healthy, field.name)
            if changed and values.setdefault(field.name, value) != value:
                raise UsageError(f"faults {[p.name for p in parts]} both set {field.name}")
    return faults.Fault("+".join(p.name for p in parts), parts[0].severity, **values)


def _layout(args: SimulateCommand) -> "EngineLayout | None":
    from training.dyno.engine import EngineLayout

    if args.injection is None:
        return None
    return EngineLayout(args.injection, args.metering or "speed_density")


def _check_needs(args: SimulateCommand) -> None:
    """Raise UsageError for an option that would have no effect."""
    from training.dyno.recording_files import TABLES

    sudden = [name for name in args.fault if name.partition("=")[0] != downstream.CATALYST_FAULT]
    is_other, is_table = args.period != SimulateCommand.period, args.format in TABLES
    for option, is_given, needs, is_there in (
        ("--metering", args.metering, "--injection", args.injection),
        ("--fault-start", args.fault_start, "a --fault that begins in a drive", sudden),
        ("--period", is_other, "--format of a table", is_table),
    ):
        if is_given and not is_there:
            raise UsageError(f"{option} needs {needs}")


def _severity(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise UsageError(f"{text!r}: wanted NAME=SEVERITY") from None
