"""The gap report: one page for a review, the verdict first."""

from importlib.metadata import version
from pathlib import Path
from typing import Final

from monitor.base.files.outputs import write_text
from training.gap.name.verdict import Candidate
from training.gap.pages import cells, gap_figures
from training.gap.pages.verdict_words import actions, cautions, confidence, verdict_sentence
from training.gap.result import Result
from training.greybox.chain import RANGES
from training.pages.numbers import p_value
from training.pages.page import page

SHOWN: Final = 8  # questions of a comparison of runs
PACKAGES: Final = ("numpy", "scipy", "onnx", "onnxruntime")


def as_page(result: Result) -> str:
    """Return the whole page as HTML; nothing is loaded from elsewhere."""
    given, good = result.inputs, "" if result.inputs.sensor_known_good else "not "
    return page(
        "gap/report.html",
        f"Model gap: {given.model.name}",
        verdict=verdict_sentence(result),
        confidence=confidence(result),
        kind=result.verdict,
        result=result,
        actions=actions(result),
        cautions=cautions(result),
        rankings=_rankings(result),
        chosen=[*(c.label for c in result.effects), *[*result.naming.posterior][:1]],
        units={name: limits.unit for name, limits in RANGES.items()},
        shown=SHOWN,
        p_value=p_value,
        cells=cells,
        draw=gap_figures,
        footer=[
            f"Model {given.model} ({given.kind}), sha256 {given.sha256}",
            f"The sensor was {good}declared good.",
            *([] if result.seconds is None else [f"The workflow took {result.seconds:.0f} s."]),
            "Packages: " + ", ".join(f"{name} {version(name)}" for name in PACKAGES),
        ],
    )


def save(result: Result, path: Path) -> None:
    """Write the page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, as_page(result))


def _rankings(result: Result) -> list[tuple[str, tuple[Candidate, ...]]]:
    """Return the ranking of each step; the last one, too, if the step added nothing."""
    last, rounds = result.naming.trials.ranking, result.naming.trials.rounds
    found = [(f"Candidates: {r.effect.name}", r.ranking) for r in rounds]
    if last and not any(r.ranking is last for r in rounds):
        found.append(("Candidates of the last step" if found else "Candidates", last))
    return found
