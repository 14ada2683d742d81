"""The command ``o2train gap``: find a missing effect, name it, add it to the model, verify it."""

import argparse
import gc
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from monitor.base.command_line.parameters import Number, Recordings
from training.cli.options import Folder, GridOptions, ModelPath, load_all, warn

if TYPE_CHECKING:
    from training.gap.result import Result

REPORT, RESULT = "report.html", "gap.json"
EXAMPLES = """examples:
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


@dataclass(frozen=True, kw_only=True)
class GapCommand(GridOptions):
    """Options of the gap workflow.

    recordings : recordings of a healthy vehicle on which the model disagrees
    model : model file of a grey-box chain or a network from o2train fit
    healthy : recordings of the same vehicle without the gap, usually the recordings on which the
        model was accepted (default: the healthy reference that o2train fit stored in the model; if
        the model has none, the command cannot tell a weakness of the model from an effect)
    verify : recordings that verify the new model; no fit sees them (default: each RECORDING, by
        constants from the others; the naming sees all)
    steps : highest number of effects to add, one after the other: 1 to 3
    sensor_known_good : the sensor was checked: try and suspect no sensor fault
    add : effects to add although they may be faults, such as exhaust_leak: the vehicle was checked
    library : list the effects with constants, bounds and sources, and exit
    out : folder for report.html, gap.json and model.onnx
    """

    recordings: Recordings = field(kw_only=False)
    model: ModelPath
    healthy: Recordings = ()
    verify: Recordings = ()
    steps: Number = 1
    sensor_known_good: bool = False
    add: Annotated[Sequence[str], "EFFECT"] = ()
    library: Annotated[bool, {"action": _Library, "nargs": 0}] = False
    out: Folder


def also_written(args: GapCommand) -> list[Path]:
    """Return the files in the folder that the command writes."""
    return [args.out / name for name in (REPORT, RESULT, "model.onnx", "offer.onnx")]


def run(args: GapCommand) -> int:
    """Locate the regimes in which a model disagrees with recordings of a healthy vehicle, name the
    physical effect that explains the disagreement, add the effect to a new model, and verify the
    new model on recordings that no fit has seen.

    Raises UsageError, ModelError or RecordingError (exit code 2).
    """
    from training.cli.progress import Progress
    from training.gap.inputs.roles import GapOptions, Material
    from training.gap.pages import gap_page
    from training.gap.pages.verdict_words import cautions
    from training.gap.result import save
    from training.gap.workflow import investigate
    from training.healthy.base import card_of

    gc.freeze()  # of the imported modules nothing becomes garbage
    options = GapOptions(args.steps, args.sensor_known_good, args.add)
    card = card_of(args.model)
    period_s = args.period if args.period is not None else card.period_ns / 1e9
    roles = (args.recordings, args.healthy, args.verify)
    material = Material(args.model, *(load_all(args, each, period_s, card) for each in roles))
    with Progress(unit="step") as bar:
        result = investigate(material, args.out, options, progress=bar.step)
    warn(cautions(result))
    save(result, args.out / RESULT)
    gap_page.save(result, args.out / REPORT)
    _print(result, args.out)
    return 0


def _print(result: "Result", out: Path) -> None:
    from training.gap.pages.verdict_words import verdict_sentence

    print(verdict_sentence(result))
    for candidate in result.naming.trials.ranking[:5]:
        merit = candidate.merit
        print(
            f"  {candidate.label}: score {merit.score:.0f} (on healthy drives up to "
            f"{merit.needed:.0f}), t {merit.t:.1f}"
        )
    if result.naming.answer.experiment is not None:
        print(f"to tell them apart: {result.naming.answer.experiment}")
    if result.unknown:
        print(result.unknown)
    if result.addition.path is not None:
        print(f"model: {result.addition.path}")
    print(f"report: {out / REPORT}")
