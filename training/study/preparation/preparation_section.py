"""The section about preparation: outliers, spectrum, noise lines, linear preparation."""

from typing import Any

from training.pages.page import part
from training.study.preparation import spectrum_figures

UNCERTAIN_DB = 3.0


def section(result: dict[str, Any]) -> str:
    """Return the section from the result of ``preparation``."""
    said: dict[str, list[str]] = {}
    for x in result["lines"]:
        if x["signal"] == result["output"]:
            said.setdefault(x["words"], []).append(f"{x['low_hz']:.2f}–{x['high_hz']:.2f} Hz")
    return part(
        "study/preparation.html",
        result=result,
        said=said,
        trends=_trends(result["linear"]),
        uncertain_db=UNCERTAIN_DB,
        draw=spectrum_figures,
    )


def _trends(linear: dict[str, Any]) -> list[tuple[float, float]]:
    """Return each signal's smallest and largest trend in deviations per minute."""
    slopes = [
        [60.0 * t["slope"][i] / std for t in linear["trends"].values()]
        for i, std in enumerate(linear["std"])
    ]
    return [(min(each), max(each)) for each in slopes]
