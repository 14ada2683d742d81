"""The command ``o2train fit``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.base.counts import plain
from training.cli.kinds import greybox
from training.cli.kinds.fit_command import FitCommand
from training.cli.options import inputs_of, load_all

if TYPE_CHECKING:
    from collections.abc import Mapping

    from monitor.model.card import ModelCard
    from training.narx.fit import FitOptions, FitResult
    from training.recordings.recording import Recording

EXAMPLES = """examples:
  o2train fit drive1.log drive2.log drive3.log --out model.onnx
  o2train fit run_*.csv.gz --inputs speed_z load_z ignition_angle_z fuel_cutoff_z \\
      --output lambda_z --out lambda.onnx
  o2train fit monday.msl tuesday.msl --out mx5.onnx
  o2train fit drive*.log --kind greybox --out chain.onnx
  o2train fit drive*.log --kind greybox --out chain.onnx --inputs fuel_mass_mg \\
      manifold_pressure_kpa manifold_temperature_degc engine_speed_rpm
"""


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
    from training.cli.console.progress import Progress
    from training.narx.fit import FitResult
    from training.narx.page.fit_verdict import fit_verdict
    from training.recordings.recording import check_each_once

    _check(args)
    recordings = load_all(args, args.recordings, args.period)
    check_each_once(recordings)
    outcome = _narx(args, recordings) if args.kind == "narx" else greybox.fit(args, recordings)
    with Progress(None, unit="step") as bar:
        fitted = Fit.of(outcome, recordings, args.columns, bar.step)
    _tell_reference(fitted.card)
    for warning in fitted.warnings:
        print(f"o2train: warning: {warning}", file=sys.stderr)
    if isinstance(outcome, FitResult):
        _print_fit(outcome)
    else:
        greybox.print_fit(outcome)
    fitted.write_report(_report(args))
    _print_measures(fitted.card)
    print(fit_verdict(fitted.card)[0])
    print(f"report: {_report(args)}")
    return 0


def also_written(args: FitCommand) -> list[Path]:
    """Return the report beside the model file, if no option names it."""
    return [] if args.report else [_report(args)]


def _check(args: FitCommand) -> None:
    """Raise UsageError for impossible options, before any recording is read."""
    from monitor.base.errors import UsageError

    if args.out.suffix != ".onnx":
        raise UsageError(f"--out {args.out}: a model file ends in .onnx")
    _options(args)
    if args.kind == "greybox":
        greybox.check(args)


def _report(args: FitCommand) -> Path:
    return args.report or args.out.with_suffix(".html")


def _narx(args: FitCommand, recordings: "list[Recording]") -> "FitResult":
    from monitor.base.signals import OUTPUT
    from training.cli.console.progress_bar import Bar
    from training.narx.fit import FitSource, fit

    source = FitSource(recordings, inputs_of(args, recordings), args.output or OUTPUT)
    with Bar(args.budget) as bar:
        return fit(source, args.out, _options(args, progress=bar.update, tried=bar.tried))


def _options(args: FitCommand, **told: Any) -> "FitOptions":
    from training.narx.fit import FitOptions

    return FitOptions(
        lags=args.lags,
        hidden=tuple(args.hidden) if args.hidden else None,
        input_lag_start=0 if args.lag_zero else 1,
        starts=args.starts,
        budget_minutes=args.budget,
        wall_minutes=args.wall,
        seed=args.seed,
        **told,
    )


def _tell_reference(card: "ModelCard") -> None:
    if learned := card.reference.get("gap"):
        print(f"healthy reference of o2train gap: {len(learned['recordings'])} recordings")


def _print_fit(result: "FitResult") -> None:
    from training.narx.network import describe

    spec = result.chosen.model.spec
    n = len(result.data.role)
    if result.tries:
        members = result.chosen.model.members
        mean = f", the mean of {members} trainings" if members > 1 else ""
        print(f"chosen of {len(result.tries)} structures: {describe(spec)}{mean}")
    print(
        f"{result.path}: {n} samples, {result.chosen.model.spec.n_weights} weights, "
        f"{result.seconds:.0f} s"
    )


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
