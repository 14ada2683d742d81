"""A log that no shipped profile knows, and a model of its car, whose card holds the profile."""

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from monitor.base.types import FloatArray
from monitor.frames.profiles.profile import load_profile
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.logs.logger_files import write_text_table
from training.healthy.new_model import tree_of
from training.narx.export import update_card


def log_and_model(folder: Path, own: Mapping[str, FloatArray]) -> tuple[Path, Path]:
    """Return log and model, which reads a column Luft that is no canonical signal.

    own : as of ``logger_files.drive``
    """
    cells = {"Uhr": own["t_s"], "Sonde": own["afr"], "Luft": own["map_kpa"]}
    log, profile = write_text_table(folder / "drive.csv", cells), folder / "own.toml"
    profile.write_text(
        'time = "Uhr"\n[signals]\nlambda_measured = { column = "Sonde", unit = "AFR" }\n'
    )
    model = folder / "car.onnx"
    shutil.copy(shipped_model(), model)
    card = Model.load(model).card
    inputs = (replace(card.inputs[0], name="Luft"), *card.inputs[1:])
    update_card(model, replace(card, inputs=inputs, profile=tree_of(load_profile(profile))))
    return log, model
