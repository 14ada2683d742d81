"""The result of a catalyst matrix as JSON and as one self-contained page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.behind import tables
from benchmarks.studies.behind.plan import FIRST_VEHICLE
from benchmarks.studies.behind.rules import LEARNING, TITLES
from benchmarks.studies.behind.targets import assess, found_text
from training.limits.rates import Figures
from training.pages.page import page, template_of

SCHEMA: Final = "o2train.catalyst_matrix/1"
VERDICTS: Final = {True: "met", False: "missed", None: "not judged"}
TEMPLATES: Final = Path(__file__).parents[1] / "templates"


def result(
    rows: Sequence[tables.Row], limits: Mapping[str, float | None], identity: dict[str, Any]
) -> Figures:
    """Return the whole result of a run.

    limits : of the rules; identity : what the run depends on, as ``run.identity`` gives it
    """
    return {
        "schema": SCHEMA,
        "source": "simulated",
        **identity,
        "rules_set_on": {"vehicles": list(LEARNING)},
        "targets": assess(rows),
        **tables.result(rows, limits),
    }


def as_page(found: Figures) -> str:
    """Return the page of a result."""
    met = [target["met"] for target in found["targets"] if target["met"] is not None]
    first = found["matrix"]["first_vehicle"]
    return page(
        template_of(TEMPLATES / "catalyst_matrix.html"),
        "Simulated drives with a catalyst",
        verdict=_verdict(found["targets"]),
        confidence=_confidence(found["targets"]),
        kind="good" if all(met) else "bad",
        found=found,
        targets=[
            (t["what"], t["wanted"], found_text(t), t["trials"], VERDICTS[t["met"]])
            for t in found["targets"]
        ],
        is_development=first < FIRST_VEHICLE,
        rule_titles=TITLES,
        footer=[
            f"Configuration {found['config_sha256'][:12]}, code {found['code_sha256'][:12]}, "
            f"vehicles from {first}"
        ],
    )


def _verdict(targets: Sequence[Figures]) -> str:
    judged = [t for t in targets if t["met"] is not None]
    missed = [t["what"] for t in judged if not t["met"]]
    told = f"{len(judged) - len(missed)} of {len(judged)} targets are met"
    return f"{told}. Missed: {'; '.join(missed)}." if missed else f"{told}."


def _confidence(targets: Sequence[Figures]) -> str:
    met = [t for t in targets if t["met"]]
    proved = sum(t["proved"] is True for t in met)
    return (
        f"the exact 95 % bounds of {proved} of {len(met)} met targets meet them, too; the others "
        "need more drives or have no bound. Everything here is simulated."
    )
