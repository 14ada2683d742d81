"""The page of a grey-box fit: its warnings, constants, figures and free runs."""

from pathlib import Path

from training.greybox.chain import RANGES
from training.greybox.model import GreyboxResult
from training.narx.page.training_page import write_page


def write_report(path: Path | str, result: GreyboxResult) -> None:
    """Write the page; figures are embedded, nothing is loaded from elsewhere."""
    title = f"Grey-box model {result.path.name}"
    charge = _charge(result)
    write_page(path, result, "fit/greybox_fit.html", title, charge=charge, ranges=RANGES)


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
