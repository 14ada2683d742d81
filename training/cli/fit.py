"""The command ``o2train fit``."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from monitor.base.command_line.parameters import Number
from monitor.base.counts import counted, plain
from training.cli.options import (
    GridOptions,
    Minutes,
    NewModel,
    Page,
    SeedOption,
    SignalOptions,
    SomeRecordings,
    inputs_of,
    load_all,
    warn,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from monitor.model.card import ModelCard
    from training.greybox.model import GreyboxResult
    from training.narx.fit import FitOptions, FitResult
    from training.recordings.recording import Recording

OF_NETWORKS = ("lags", "lag_zero", "hidden", "starts", "budget", "wall")
EXAMPLES = """examples:
  o2train fit drive1.log drive2.log drive3.log --out model.onnx
  o2train fit run_*.csv.gz --inputs speed_z load_z ignition_angle_z fuel_cutoff_z \\
      --output lambda_z --out lambda.onnx
  o2train fit monday.msl tuesday.msl --out mx5.onnx
  o2train fit drive*.log --kind greybox --out chain.onnx
  o2train fit drive*.log --kind greybox --out chain.onnx --inputs fuel_mass_mg \\
      manifold_pressure_kpa manifold_temperature_degc engine_speed_rpm
"""


@dataclass(frozen=True, kw_only=True)
class FitCommand(SignalOptions, SeedOption, GridOptions):
    """Options of a fit.

    out : model file to write
    kind : narx: a network; greybox: the physical chain of charge and fuel, transport, mixing and
        sensor with a few constants
    lags : longest lag in samples (default: chosen from the data; 5 with --hidden)
    lag_zero : let the network also read the inputs of the predicted tick (without --lags and
        --hidden the data choose the lags)
    hidden : neurons per hidden layer (default: chosen from the data; 8 8 with --lags)
    starts : number of trainings from random weights (default: 3 of a shape that is given, of which
        the best is the model; about 4 after a search, whose mean is)
    budget : work of the training, in minutes of one core of a 2.1 GHz Xeon; the same seed, data
        and budget give the same file on every machine of a kind
    wall : minutes after which the training ends early, whatever is left of its work
    report : report to write (default: beside the model file)
    """

    recordings: SomeRecordings = field(kw_only=False)
    out: NewModel
    kind: Literal["narx", "greybox"] = "narx"
    lags: Number | None = None
    lag_zero: bool = False
    hidden: Annotated[Sequence[int] | None, "N"] = None
    starts: Number | None = None
    budget: Minutes = 10.0
    wall: Minutes | None = None
    report: Page = None


def run(args: FitCommand) -> int:
    """Train a NARX.

    The command chooses memory and size by free run on held-out blocks, trains the network
    series-parallel, then in closed loop over growing horizons, and last on all samples; twins
    without some recordings measure it. --lags or --hidden fix the shape, without a linear path.
    --kind greybox fits the constants of the physical chain, which reads its charge as air per
    stroke; with manifold pressure and temperature among --inputs it computes the charge from them
    and a map.

    Raises UsageError or RecordingError (exit code 2).
    """
    from training.api.models import Fit
    from training.cli.progress import Progress
    from training.narx.page.fit_verdict import fit_verdict
    from training.recordings.recording import check_each_once

    options = _options(args)
    recordings = load_all(args, args.recordings, args.period)
    check_each_once(recordings)
    outcome = _fitted(args, recordings, options)
    with Progress(unit="step") as bar:
        fitted = Fit.of(outcome, recordings, args.columns, bar.step)
    if learned := fitted.card.reference.get("gap"):
        print(f"healthy reference of o2train gap: {len(learned['recordings'])} recordings")
    warn(fitted.warnings)
    _print(outcome)
    fitted.write_report(_report(args))
    _print_measures(fitted.card)
    print(fit_verdict(fitted.card)[0])
    print(f"report: {_report(args)}")
    return 0


def also_written(args: FitCommand) -> list[Path]:
    """Return the report beside the model file, if no option names it."""
    return [] if args.report else [_report(args)]


def _report(args: FitCommand) -> Path:
    return args.report or args.out.with_suffix(".html")


def _options(args: FitCommand) -> "FitOptions":
    """Return how a network is trained; raises UsageError for impossible options of any kind."""
    from monitor.base.errors import UsageError
    from training.narx.fit import FitOptions

    given = [name for name in OF_NETWORKS if getattr(args, name) != getattr(FitCommand, name)]
    if args.kind == "greybox" and given:
        wrong = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise UsageError(f"{wrong}: a grey-box model has no such thing, a NARX has")
    return FitOptions(
        lags=args.lags,
        hidden=tuple(args.hidden) if args.hidden else None,
        input_lag_start=0 if args.lag_zero else 1,
        starts=args.starts,
        budget_minutes=args.budget,
        wall_minutes=args.wall,
        seed=args.seed,
    )


def _fitted(
    args: FitCommand, recordings: "list[Recording]", options: "FitOptions"
) -> "FitResult | GreyboxResult":
    from monitor.base.signals import OUTPUT
    from training.cli.progress import Budget, Share
    from training.greybox.model import fit_greybox
    from training.narx.fit import FitSource, fit

    output = args.output or OUTPUT
    if args.kind == "greybox":
        with Share("grey-box fit") as bar:
            how: dict[str, Any] = {"seed": args.seed, "progress": bar.update}
            return fit_greybox(recordings, args.out, inputs=args.inputs, output=output, **how)
    source = FitSource(recordings, inputs_of(args, recordings), output)
    with Budget(args.budget) as spent:
        return fit(source, args.out, replace(options, progress=spent.spend, tried=spent.tried))


def _print(result: "FitResult | GreyboxResult") -> None:
    from training.narx.fit import FitResult
    from training.narx.network import describe

    told = f"{result.path}: {len(result.data.role)} samples"
    if isinstance(result, FitResult):
        model = result.chosen.model
        if result.tries:
            mean = f", the mean of {model.members} trainings" if model.members > 1 else ""
            tried = counted(len(result.tries), "structure")
            print(f"chosen of {tried}: {describe(model.spec)}{mean}")
        print(f"{told}, {model.spec.n_weights} weights, {result.seconds:.0f} s")
        return
    print(f"{told}, grey-box chain, {result.seconds:.0f} s")
    for name, constant in result.card.structure["constants"].items():
        print(constant_line(name, constant))
    for effect in result.greybox.own:
        print(f"healthy vehicle's {effect.in_words}")


def constant_line(name: str, constant: "Mapping[str, Any]") -> str:
    """Return one line of text for a constant of the model card, with its unit and error."""
    value, error, unit = (constant[key] for key in ("value", "standard_error", "unit"))
    if error > abs(value):
        return f"constant {name}: {value:.4f} {unit} (the recordings hardly hold it)"
    return f"constant {name}: {value:.4f} ± {error:.4f} {unit}"


def _print_measures(card: "ModelCard") -> None:
    every, enabled = card.fit["test"], card.fit["test_enabled"]
    differ = enabled != every  # equal if no recorded signal tells which samples are enabled
    if differ:
        _print_measure("held out, enabled samples", enabled, card)
    title = "held out, all samples, fuel cuts too" if differ else "held out"
    _print_measure(title, every, card)
    if len(unseen := card.fit.get("unseen", {}).get("recordings", ())) > 1:
        worst = min(unseen, key=lambda each: each["fit_percent"])
        print(f"held out, worst recording: fit {worst['fit_percent']:.0f} % ({worst['path']})")


def _print_measure(title: str, figures: "Mapping[str, Any]", card: "ModelCard") -> None:
    if "rmse" not in figures:
        return
    unit = f"in {card.output.name}" if card.output.unit in ("", "-") else card.output.unit
    print(
        f"{title}: free run fit {figures['fit_percent']:.1f} %, "
        f"correlation {figures['correlation']:.4f}, RMSE {plain(figures['rmse'])} "
        f"{unit}, {figures['samples']:.0f} samples"
    )
