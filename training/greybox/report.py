"""A self-contained HTML report of a grey-box fit."""

from pathlib import Path

from training.greybox.model import GreyboxResult
from training.narx.report import held_out_run, measures_table, recordings_table, scatter
from training.pages.page import page, paragraph, picture, table

MEANING = {
    "gain": "of fuel over air: injector, air meter and fuel in one",
    "dead_time_s": "part of the dead time that does not follow engine speed",
    "dead_time_revolutions": "part that follows engine speed",
    "mixing_s": "first lag, the shorter one: mixing in the exhaust",
    "sensor_s": "second lag: the sensor",
    "span": "sensitivity of the sensor about lambda 1",
}


def write_report(path: Path | str, result: GreyboxResult) -> None:
    """Write the report; figures are embedded, nothing is loaded from elsewhere."""
    body = "\n".join(
        [
            *(paragraph(w, "warning") for w in result.warnings),
            _overview(result),
            _constants(result),
            measures_table(result),
            picture(held_out_run(result), "Free run (orange) and measurement on held-out blocks"),
            picture(scatter(result), "Prediction over measurement; residuals"),
        ]
    )
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(page(f"Grey-box model {result.path.name}", body))


def _overview(result: GreyboxResult) -> str:
    card, fitted = result.card, result.fitted
    stability, parity = card.checks["contraction"], card.checks["parity"]
    rows = [
        ("inputs", ", ".join(card.input_names)),
        ("output", f"{card.output.name} [{card.output.unit or 'as recorded'}]"),
        ("sample period", f"{card.period_ns / 1e9:g} s"),
        ("chain", "fuel over air, dead time, two lags, span"),
        *(("healthy vehicle's own", own.in_words) for own in result.greybox.own),
        ("charge", _charge(result)),
        (
            "samples",
            f"{len(result.data.role)} of {len(card.recordings)} recordings, "
            f"{fitted.samples} of them fitted",
        ),
        ("free run on the fitted samples", f"RMSE {fitted.rmse:.4g} in phi"),
        (
            "the same, whitened",
            f"RMSE {fitted.white_rmse:.4g} in phi, residual AR "
            + ", ".join(f"{a:.3f}" for a in fitted.noise_model),
        ),
        ("starts", f"end within {100 * fitted.spread:.2g} % of the same whitened RMSE"),
        (
            "two states after 50 samples",
            f"differ by at most {stability['gap']:.2g} (limit {stability['limit']:.2g})",
        ),
        (
            "ONNX against numpy, free run",
            f"{parity['onnx_numpy']:.2g} (tolerance {parity['tolerance']:.2g})",
        ),
    ]
    return table(rows) + recordings_table(card)


def _charge(result: GreyboxResult) -> str:
    charge_map = result.greybox.charge_map
    if charge_map is not None:
        speeds, pressures = charge_map.inverse_efficiency.shape
        return (
            f"density in the manifold times an efficiency of {speeds} speeds by "
            f"{pressures} pressures, fitted for a gain of 1"
        )
    error = result.greybox.charge_error
    if error is not None:
        speeds, charges = error.now.shape
        return (
            f"air per stroke as recorded, less its error over {speeds} speeds by {charges} charges "
            f"now and over the last {error.time_s:g} s"
        )
    if "air_mass_mg" in result.card.input_names:
        return "air per stroke as recorded"
    return "air meter over engine speed"


def _constants(result: GreyboxResult) -> str:
    structure = result.card.structure
    rows = [
        (
            f"{name}: {MEANING[name]}",
            f"{c['value']:.4f}",
            f"{c['standard_error']:.4f}",
            c["unit"],
            f"{c['low']:g} to {c['high']:g}",
        )
        for name, c in structure["constants"].items()
    ]
    sums = [
        (name, f"{d['value']:.4f}", f"{d['standard_error']:.4f}", d["unit"], "")
        for name, d in result.card.reference["derived"].items()
    ]
    head = ("constant", "value", "standard error", "unit", "bounds")
    note = paragraph(f"Standard errors: {structure['standard_errors']}.", "note")
    fixed = paragraph(
        "Fixed: " + "; ".join(f"{k} is {v}" for k, v in structure["fixed"].items()) + ".", "note"
    )
    return "<h2>Constants</h2>" + table([*rows, *sums], head) + note + fixed
