"""The command ``o2train calibrate``: set the decision limits of a model."""

from typing import Annotated

from monitor.base.command_line.parameters import Output, Recordings, SettingsFile
from training.cli.options import ModelPath, NewModel, Page, ReadOptions, load_all, warn

EXAMPLES = """examples:
  o2train calibrate --model model.onnx --healthy drives/*_healthy.log
  o2train calibrate --model model.onnx --healthy good/*.log --faulty limit/*.log \\
      --out calibrated.onnx --report calibration.html
"""
changed_in_place = "model"


def run(
    *,
    model: ModelPath,
    healthy: Recordings,
    faulty: Recordings = (),
    emission_limit: Annotated[float | None, "TIMES"] = None,
    out: NewModel | None = None,
    settings: SettingsFile,
    reading: ReadOptions,
    json: Output = None,
    report: Page = None,
) -> int:
    """Set the decision limits of a model and write them into its model file.

    The limits come from healthy recordings. With them every recording is judged; recordings with a
    faulty sensor show what is found.

    model : model file to calibrate
    healthy : healthy recordings that the model was not trained on
    faulty : recordings with a sensor fault (default: none)
    emission_limit : propose limits of lag, dead time and gain: severities from which three
        simulated cars with a catalyst emit so many times as much as with a sound sensor, for
        example 1.5; takes a minute
    out : model file to write (default: the file of --model is changed)
    json : write the limits and all figures as JSON
    report : write an HTML report
    Raises UsageError, ConfigError, ModelError or RecordingError (exit code 2).
    """
    from monitor.base import config
    from monitor.base.files.outputs import write_text
    from monitor.model.step import Model
    from training.jobs.run_folder import write_json
    from training.limits.calibration import calibrate
    from training.limits.calibration_page import as_page, as_text
    from training.narx.export import update_card

    goal = out or model
    emissions = {}
    if emission_limit is not None:
        from training.dyno.tailpipe import proposal

        emissions["emissions"] = proposal(emission_limit)
    before = Model.load(model).card
    good, bad = (load_all(reading, g, before.period_ns / 1e9, before) for g in (healthy, faulty))
    card, result = calibrate(model, good, bad, config.load(settings.config))
    result |= emissions
    update_card(model, card, goal)
    warn(result["warnings"])
    print(as_text(result))
    if json:
        write_json(json, result, indent=1)
    if report:
        write_text(report, as_page(result))
    print(f"limits written to {goal}")
    return 0
