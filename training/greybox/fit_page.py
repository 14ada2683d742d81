"""The page of a grey-box fit: its warnings, constants, figures and free runs."""

from pathlib import Path

from training.greybox.chain import RANGES
from training.greybox.model import GreyboxResult
from training.narx.page.training_page import write_page


def write_report(path: Path | str, result: GreyboxResult) -> None:
    """Write the page."""
    title = f"Grey-box model {result.path.name}"
    write_page(path, result, "fit/greybox_fit.html", title, ranges=RANGES)
