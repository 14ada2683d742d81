"""The report of a fleet: a page, and the same figures as JSON."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from training.fleet import outliers, page, summary
from training.fleet.bench import Bench, tools_of
from training.fleet.run import windows_path
from training.jobs import run_folder


def write(out: Path, bench: Bench, run: Mapping[str, Any], wished: float) -> tuple[Path, Path]:
    """Write the page and the JSON beside the table ``out``; return their paths.

    run : result of ``run.run``
    wished : wanted false-alarm rate per window or drive, for the proposed limits
    """
    recordings, windows = pl.read_parquet(out), windows_path(out)
    limits = tools_of(bench).limits
    now = {"j_mu": limits.j_mu, "j_sigma": limits.j_sigma, "offset": limits.offset_high}
    standing = outliers.standings(recordings)
    found = summary.summary(recordings, windows, run, now, wished, standing)
    html, tree = out.with_suffix(".html"), out.with_suffix(".json")
    run_folder.write_json(tree, found, indent=1)
    begun = out.with_name(f"{html.name}.begun")
    begun.write_text(page.as_page(found, recordings, windows, standing))
    begun.replace(html)
    return html, tree
