"""The command ``o2train gap``: find a missing effect, name it, add it to the model, verify it."""

import argparse
import gc
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from monitor.base.command_line import option_paths as paths
from training.cli.recordings import add_bus_options, add_period_option, load_all

if TYPE_CHECKING:
    from training.gap.inputs.roles import Material
    from training.gap.result import Result

REPORT, RESULT = "report.html", "gap.json"
_EXAMPLES = """examples:
  o2train gap --model chain.onnx new1.log new2.log new3.log --healthy old*.log --out gap
  o2train gap --model model.onnx new*.parquet --healthy old*.parquet --out gap --steps 3
  o2train gap --model chain.onnx new*.log --healthy old*.log --out gap --add exhaust_leak
  o2train gap --model chain.onnx new*.csv --healthy old*.csv --columns channels.toml --out gap

Every recording needs fuel_mass_mg, lambda_measured and signals of the charge, one of:
  air_mass_mg with engine_speed_rpm or maf_kg_h
  maf_kg_h with engine_speed_rpm
  manifold_pressure_kpa and manifold_temperature_degc with engine_speed_rpm, for a chain that
    computes its charge from them (o2train fit --kind greybox --inputs)
docs/reference/signals.md lists names and units of all signals. --columns renames columns.

Give several recordings of ten minutes each, of mixed driving, both as RECORDING and as --healthy.
"""


class _Library(argparse.Action):
    """Print the library and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from training.gap.pages.library import as_text

        print(as_text())
        parser.exit()


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``gap`` to ``subparsers``."""
    gap = subparsers.add_parser(
        "gap",
        help="find the effect that a model lacks on a healthy vehicle, name it and add it",
        description="Locate the regimes in which a model disagrees with recordings of a healthy\n"
        "vehicle, name the physical effect that explains the disagreement, add the effect to a\n"
        "new model, and verify the new model on recordings that no fit has seen.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_recordings(gap)
    _add_choices(gap)
    add_period_option(gap)
    add_bus_options(gap)
    gap.set_defaults(
        func=run,
        also_written=lambda args: [args.out / name for name in (REPORT, RESULT, "model.onnx")],
    )


def _add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add the model and the recordings in their roles."""
    parser.add_argument(
        "recordings",
        nargs="+",
        type=paths.read,
        metavar="RECORDING",
        help="recordings of a healthy vehicle on which the model disagrees",
    )
    parser.add_argument(
        "--model",
        type=paths.read,
        required=True,
        metavar="MODEL.onnx",
        help="model file of a grey-box chain or a network from o2train fit",
    )
    parser.add_argument(
        "--healthy",
        nargs="+",
        type=paths.read,
        default=[],
        metavar="RECORDING",
        help="recordings of the same vehicle without the gap, usually the recordings on which the "
        "model was accepted (default: the healthy reference that o2train fit stored in the "
        "model; if the model has none, the command cannot tell a weakness of the model from an "
        "effect)",
    )
    parser.add_argument(
        "--verify",
        nargs="+",
        type=paths.read,
        default=[],
        metavar="RECORDING",
        help="recordings that verify the new model; no fit sees them. They also choose between "
        "the ways to add the effect (default: every third RECORDING, which the naming sees)",
    )


def _add_choices(parser: argparse.ArgumentParser) -> None:
    """Add the folder and how the workflow names and adds."""
    parser.add_argument(
        "--library",
        action=_Library,
        nargs=0,
        help="list the effects with constants, bounds and sources, those of plug-ins too, and exit",
    )
    parser.add_argument(
        "--out",
        type=paths.folder,
        required=True,
        metavar="DIR",
        help="folder for report.html, gap.json and model.onnx",
    )
    parser.add_argument(
        "--steps",
        type=int,
        default=1,
        metavar="N",
        help="highest number of effects to add, one after the other: 1 to 3 (default 1)",
    )
    parser.add_argument(
        "--sensor-known-good",
        action="store_true",
        help="the sensor was checked: try and suspect no sensor fault",
    )
    parser.add_argument(
        "--add",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="effects to add although they may be faults, for example exhaust_leak, because the "
        "vehicle was checked",
    )
    parser.add_argument(
        "--retrain",
        type=float,
        default=3.0,
        metavar="MIN",
        help="minutes to train a network again with the effect as an additional input; the "
        "command keeps the better of both ways to add the effect (default 3; 0: no training)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the gap workflow, write model and reports, and return exit code 0 for any verdict.

    Raises UsageError, ModelError or RecordingError (exit code 2).
    """
    from monitor.frames.text.python_can import import_without_mdf

    import_without_mdf()
    from tqdm import tqdm

    from training.gap.inputs.roles import Material, options_of
    from training.gap.pages import gap_page
    from training.gap.pages.verdict_words import cautions
    from training.gap.result import save
    from training.gap.workflow import NEW_MODEL, investigate
    from training.jobs.cache import cached

    gc.freeze()  # of the imported modules nothing becomes garbage
    options = options_of(args.steps, args.sensor_known_good, _effects(args.add), args.retrain)
    period_s = args.period if args.period is not None else _period_s(args.model)
    material = Material(
        args.model,
        *(
            load_all(args, paths, period_s)
            for paths in (args.recordings, args.healthy, args.verify)
        ),
    )
    args.out.mkdir(parents=True, exist_ok=True)
    learned = cached("healthy", _vehicle(material))
    with tqdm(unit="step", leave=False, disable=args.nothing or None) as bar:

        def progress(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        result = investigate(material, args.out, options, learned=learned, progress=progress)
    if result.addition.path is None:  # an earlier run may have left a model
        (args.out / NEW_MODEL).unlink(missing_ok=True)
    for warning in cautions(result):
        print(f"o2train: warning: {warning}", file=sys.stderr)
    save(result, args.out / RESULT)
    gap_page.save(result, args.out / REPORT)
    _print(result, args.out)
    return 0


def _period_s(model: Path) -> float:
    from training.healthy.base import card_of

    return card_of(model).period_ns / 1e9


def _effects(names: list[str]) -> list[str]:
    from monitor.base.errors import UsageError
    from training.greybox.effects import LIBRARY

    for name in names:
        if name not in LIBRARY:
            raise UsageError(f"effect {name!r} is unknown; there are {', '.join(LIBRARY)}")
    return names


def _vehicle(material: "Material") -> dict[str, Any]:
    """Return digests of model, code and healthy recordings; equal ones give equal behaviour."""
    from training.greybox.effects.brought import origins
    from training.jobs.run_folder import code_sha256
    from training.recordings.recording import sha256

    return {
        "model": sha256(material.model),
        "plugins": origins(),
        "code": code_sha256(),
        "healthy": [(r.path.name, r.read_sha256) for r in material.healthy],
    }


def _print(result: "Result", out: Path) -> None:
    from training.gap.name.decision import T_LEAST
    from training.gap.pages.verdict_words import verdict_sentence

    print(verdict_sentence(result))
    before, after, floor, measured_on = result.rmse
    then = "" if after is None else f", {after:.4f} after"
    print(
        f"RMSE in {result.inputs.unit} on {measured_on}: {before:.4f} before{then}, "
        f"noise floor {floor:.4f}"
    )
    for candidate in result.naming.trials.ranking[:5]:
        merit = candidate.merit
        print(
            f"  {candidate.name}: score {merit.score:.0f} ({merit.needed:.0f} needed), "
            f"t {merit.t:.1f} ({T_LEAST:.0f} needed)"
            + ("" if merit.physical else ", with constants that it cannot have")
        )
    if result.naming.answer.experiment is not None:
        print(f"to tell them apart: {result.naming.answer.experiment}")
    if result.unknown:
        print(result.unknown)
    if result.addition.path is not None:
        print(f"model: {result.addition.path}")
    print(f"report: {out / REPORT}")
