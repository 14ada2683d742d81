"""Writes the monitor as C: the templates, and the generated model and tables.

The Python stays the reference: a test compares the verdicts of both on every replay log.
"""

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Final

from monitor.base.config import Config
from monitor.base.errors import ConfigError, UsageError
from monitor.base.files.outputs import write_text
from monitor.controller import network
from monitor.controller.tables import FURTHER, ExportSource, header, tables
from monitor.judge.limits import Limits, in_unit
from monitor.model import model_file
from monitor.model.card import USUAL_PREDICTION, prediction_name
from monitor.model.step import Model

TEMPLATES: Final = (
    "o2_monitor.h",
    "o2_monitor.c",
    "o2_rules.h",
    "o2_rules.c",
    "o2_types.h",
    "example.c",
    "CMakeLists.txt",
    "README.md",
)
FILES: Final = (*TEMPLATES, "o2_model.c", "o2_tables.h", "o2_tables.c")


def export(model: Model, config: Config, out: Path, without: Sequence[str] = ()) -> list[Path]:
    """Write the monitor as C into a folder; return the files.

    without : signals that the controller does not have, beside the model's
    Raises ModelError if the model has no limits or cannot be written in C, UsageError for a signal
    that is not optional, ConfigError if the settings do not fit into the C code.
    """
    unknown = [name for name in without if name not in FURTHER]
    needed = [name for name in without if name in model.card.input_names]
    if unknown or needed:
        raise UsageError(f"--without {[*unknown, *needed][0]}: wanted some of {', '.join(FURTHER)}")
    if config.rules.active:
        raise ConfigError(f"the rule {config.rules.active[0]} of a plug-in is not written in C")
    limits = Limits.from_card(model.card, config, str(model.path))
    source = ExportSource(model.card, limits, in_unit(config, model.card), without)
    prediction = prediction_name(model.card.output.name)
    found = model_file.read(model.path).graph
    if not any(prediction in node.outputs for node in found.nodes):
        prediction = USUAL_PREDICTION
    n_inputs, n_state, name = len(model.card.inputs), model.card.state.size, model.path.name
    texts = {
        "o2_model.c": network.step_code(found, prediction, n_inputs, n_state, name),
        "o2_tables.h": header(source),
        "o2_tables.c": tables(source),
    }
    folder = files("monitor.controller") / "templates"
    texts |= {name: (folder / name).read_text(encoding="utf-8") for name in TEMPLATES}
    out.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_text(out / name, text)
    return [out / name for name in texts]
