"""The command ``o2train evaluate``."""

from monitor.base.command_line.parameters import Number, Output
from monitor.base.counts import plain
from training.cli.options import GridOptions, ModelPath, SomeRecordings, load_all

EXAMPLES = """examples:
  o2train evaluate --model model.onnx drive4.log
  o2train evaluate --model model.onnx drive4.log drive5.log --washout 20 --json figures.json
  o2train evaluate --model model.onnx drive*.log --healthy     # false alarms: stated, observed
"""


def run(
    recordings: SomeRecordings,
    *,
    model: ModelPath,
    reading: GridOptions,
    washout: Number | None = None,
    healthy: bool = False,
    json: Output = None,
) -> int:
    """Predict every recording by free run of a model and report the errors in the unit of the
    output.

    model : model file to evaluate
    washout : number of first samples that set the state from the measured output and are not scored
        (default: the longest lag)
    healthy : the sensors were sound; say how many drives have a code, and how many may have one
    json : write the figures as JSON
    Raises UsageError, ModelError or RecordingError (exit code 2).
    """
    from monitor.model.step import Model
    from training.jobs.run_folder import write_json
    from training.limits.evaluation import alarms_in_words, evaluate

    card = Model.load(model).card
    period_s = reading.period if reading.period is not None else card.period_ns / 1e9
    drives = load_all(reading, recordings, period_s, card)
    result = evaluate(model, drives, washout, healthy=healthy)
    for r in result["recordings"]:
        fit = r["fit_percent"]
        simulated = " (simulated)" if r["source"] == "simulated" else ""
        print(
            f"{r['path']}{simulated}: {r['samples']} samples, RMSE {plain(r['rmse'])}, "
            f"fit {'-' if fit is None else f'{fit:.1f} %'}, "
            f"correlation {_number(r['correlation'])}, one-step RMSE {plain(r['one_step_rmse'])}"
        )
        if e := r["enabled"]:
            figures = f"RMSE {plain(e['rmse'])}, correlation {_number(e['correlation'])}"
            print(f"  enabled: {e['samples']} samples, {figures}")
        else:
            print("  enabled: no sample, so the monitor would judge nothing of it")
    if healthy:
        print(alarms_in_words(result["false_alarms"]))
    if json:
        write_json(json, result, indent=1)
    return 0


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
