"""``o2mon export-c``: write the monitor as C for a controller."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import Input
from monitor.cli.options import say

EXAMPLES = """examples:
  o2mon export-c --out o2c                                  the shipped model
  o2mon export-c --model my.onnx --config my.toml --out o2c
  o2mon export-c --out o2c --without purge_duty_percent ambient_pressure_kpa

exit code: 0 done"""


def also_written(args: argparse.Namespace) -> list[Path]:
    """Return the files in the folder that the command writes."""
    from monitor.controller.export import FILES

    return [args.out / name for name in FILES]


def run(
    *,
    out: Annotated[Path, paths.folder, "DIR"],
    model: Input | None = None,
    config: Input | None = None,
    without: Annotated[Sequence[str], "SIGNAL"] = (),
) -> int:
    """Write the monitor as C99, without heap or libraries but libm; README.md there says more.

    out : folder for the C files
    model : ONNX model with its card (default: shipped)
    config : TOML file that changes the shipped settings
    without : signals that the controller does not have, beside those of the model
    """
    from monitor.base import config as settings
    from monitor.controller.export import export
    from monitor.model.step import Model
    from monitor.pipeline.replay import shipped_model

    loaded = Model.load(model or shipped_model())
    for path in export(loaded, settings.load(config), out, without):
        say(str(path))
    return 0
