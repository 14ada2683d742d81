"""The command ``o2train fit``."""

import argparse
import sys
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.base.command_line import option_paths as paths
from training.cli import catalyst, greybox
from training.cli.recordings import add_recordings, add_signal_options, inputs_of, load_all
from training.cli.seeds import add_seed_option, check_seed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from monitor.model.card import ModelCard
    from training.narx.fit import FitResult
    from training.recordings.recording import Recording

_EXAMPLES = """examples:
  o2train fit drive1.log drive2.log drive3.log --out model.onnx
  o2train fit run_*.csv.gz --inputs speed_z load_z ignition_angle_z fuel_cutoff_z \\
      --output lambda_z --out lambda.onnx
  o2train fit monday.msl tuesday.msl --out mx5.onnx
  o2train fit drive*.log --kind greybox --out chain.onnx
  o2train fit drive*.log --kind greybox --out chain.onnx --inputs fuel_mass_mg \\
      manifold_pressure_kpa manifold_temperature_degc engine_speed_rpm
  o2train fit drive*.log --kind greybox --output downstream_voltage_v --out catalyst.json
"""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``fit`` to ``subparsers``."""
    fit = subparsers.add_parser(
        "fit",
        help="train a model on recordings of a healthy vehicle",
        description="Train a NARX. The command chooses memory and size by free run on held-out\n"
        "blocks, trains the network series-parallel, then in closed loop over growing horizons,\n"
        "and keeps the network that predicts the held-out blocks best. --lags or --hidden fix the\n"
        "shape, without a linear path. --kind greybox fits the constants of the physical chain\n"
        "instead. The chain reads its charge as air per stroke; with manifold pressure and\n"
        "temperature among --inputs it computes the charge from them and a map. With --output\n"
        "downstream_voltage_v it fits capacity, filling and release of the catalyst and the\n"
        "sensor behind it, and writes them with standard errors as JSON.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_recordings(fit)
    fit.add_argument(
        "--out",
        type=paths.written_model,
        required=True,
        metavar="MODEL.onnx",
        help="model file to write",
    )
    fit.add_argument(
        "--kind",
        choices=("narx", "greybox"),
        default="narx",
        help="narx: a network; greybox: the physical chain of charge and fuel, transport, mixing "
        "and sensor with a few constants (default narx)",
    )
    add_signal_options(fit)
    fit.add_argument(
        "--validate",
        nargs="+",
        type=paths.read,
        default=[],
        metavar="RECORDING",
        help="recordings that choose the network and stop the training; no training uses them "
        "(default: held-out blocks of every recording)",
    )
    _add_network(fit)
    fit.add_argument(
        "--report",
        type=paths.written,
        metavar="HTML",
        help="report to write (default: beside the model file)",
    )
    fit.set_defaults(func=run, also_written=lambda args: [] if args.report else [_report(args)])


def _add_network(parser: argparse.ArgumentParser) -> None:
    """Add the shape of the network and its trainings."""
    parser.add_argument(
        "--lags",
        type=int,
        metavar="N",
        help="longest lag in samples (default: chosen from the data; 5 with --hidden)",
    )
    parser.add_argument(
        "--lag-zero",
        action="store_true",
        help="let the network also read the inputs of the predicted tick (without --lags and "
        "--hidden the data choose the lags)",
    )
    parser.add_argument(
        "--hidden",
        type=int,
        nargs="+",
        metavar="N",
        help="neurons per hidden layer (default: chosen from the data; 8 8 with --lags)",
    )
    parser.add_argument(
        "--ratio",
        action="store_true",
        help="give the network the fuel-air ratio instead of the fuel mass",
    )
    parser.add_argument(
        "--starts",
        type=int,
        metavar="N",
        help="number of trainings from random weights (default 3; 8 below 5000 samples); up to "
        "three more if no network forgets its initial state",
    )
    parser.add_argument(
        "--budget",
        type=float,
        default=10.0,
        metavar="MIN",
        help="minutes after which the training stops and keeps its best network (default 10)",
    )
    add_seed_option(parser)


def run(args: argparse.Namespace) -> int:
    """Train a model, write it with limits, reference and report, and return exit code 0.

    Raises UsageError or RecordingError (exit code 2).
    """
    from tqdm import tqdm

    from training.api.models import Fit
    from training.narx.fit import FitResult
    from training.narx.page.fit_verdict import fit_verdict
    from training.recordings.recording import check_each_once

    if args.kind == "greybox" and args.output == catalyst.OUTPUT:
        return catalyst.run(args)
    report = _check_fit(args)
    recordings = load_all(args, args.recordings, args.period)
    check_each_once(recordings)
    outcome = _narx(args, recordings) if args.kind == "narx" else greybox.fit(args, recordings)
    with tqdm(unit="step", leave=False, disable=args.nothing or None) as bar:

        def progress(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        fitted = Fit.of(outcome, recordings, args.columns, progress)
    _print_limits(fitted.card)
    for warning in fitted.warnings:
        print(f"o2train: warning: {warning}", file=sys.stderr)
    if isinstance(outcome, FitResult):
        _print_fit(outcome)
    else:
        greybox.print_fit(outcome)
    fitted.write_report(report)
    _print_measures(fitted.card)
    print(fit_verdict(fitted.card)[0])
    print(f"report: {report}")
    return 0


def _check_fit(args: argparse.Namespace) -> Path:
    """Return the path of the report; raise UsageError for impossible options."""
    from monitor.base.errors import UsageError

    if (
        min(*(1 if n is None else n for n in (args.lags, args.starts)), *(args.hidden or (1,))) < 1
        or not args.budget > 0
    ):
        raise UsageError("--lags, --starts, --hidden and --budget must be positive")
    if args.out.suffix != ".onnx":
        raise UsageError(f"--out {args.out}: a model file ends in .onnx")
    check_seed(args)
    report = _report(args)
    if args.kind == "greybox":
        greybox.check(args)
    return report


def _report(args: argparse.Namespace) -> Path:
    report: Path = args.report or args.out.with_suffix(".html")
    return report


def _narx(args: argparse.Namespace, recordings: "list[Recording]") -> "FitResult":
    from monitor.base.errors import UsageError
    from monitor.base.signals import OUTPUT
    from training.cli.progress_bar import Bar
    from training.narx.fit import FitOptions, FitSource, fit
    from training.recordings.samples.transforms import fuel_air_ratio

    validate = load_all(args, args.validate, args.period)
    inputs = inputs_of(args, (*recordings, *validate))
    if args.ratio and not {"fuel_mass_mg", "air_mass_mg"} <= set(inputs):
        raise UsageError("--ratio needs the inputs fuel_mass_mg and air_mass_mg")
    nowhere = StringIO() if args.nothing else None
    with Bar(args.budget, nowhere) as bar:
        options = FitOptions(
            lags=args.lags,
            hidden=tuple(args.hidden) if args.hidden else None,
            input_lag_start=0 if args.lag_zero else 1,
            starts=args.starts,
            budget_minutes=args.budget,
            seed=args.seed,
            progress=bar.update,
            tried=bar.tried,
        )
        transforms = [fuel_air_ratio()] if args.ratio else []
        source = FitSource(recordings, inputs, args.output or OUTPUT, validate, transforms)
        return fit(source, args.out, options)


def _print_limits(card: "ModelCard") -> None:
    for name, limit in card.limits.items():
        print(f"limit {name}: {limit.value:.4g} {limit.unit} ({limit.origin})")
    if learned := card.reference.get("gap"):
        print(f"healthy reference of o2train gap: {len(learned['recordings'])} recordings")


def _print_fit(result: "FitResult") -> None:
    from training.narx.network import describe

    spec = result.network.spec
    n = len(result.data.role)
    if result.tries:
        members = result.starts[result.best].members
        mean = f", the mean of {members} trainings" if members > 1 else ""
        print(f"chosen of {len(result.tries)} structures: {describe(spec)}{mean}")
    print(
        f"{result.path}: {n} samples, {result.network.spec.n_weights} weights, "
        f"{result.seconds:.0f} s"
    )


def _print_measures(card: "ModelCard") -> None:
    every, enabled = card.fit["test"], card.fit["test_enabled"]
    differ = enabled != every  # equal if no recorded signal tells which samples are enabled
    if differ:
        _print_measure("held-out blocks, enabled samples", enabled, card)
    title = "held-out blocks, all samples, fuel cuts too" if differ else "held-out blocks"
    _print_measure(title, every, card)


def _print_measure(title: str, figures: "Mapping[str, Any]", card: "ModelCard") -> None:
    if "rmse" not in figures:
        return
    unit = f"in {card.output.name}" if card.output.unit == "-" else card.output.unit
    print(
        f"{title}: free run fit {figures['fit_percent']:.1f} %, "
        f"correlation {figures['correlation']:.4f}, RMSE {figures['rmse']:.4g} "
        f"{unit}, {figures['samples']:.0f} samples"
    )
