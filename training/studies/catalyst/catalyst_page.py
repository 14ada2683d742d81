"""The result of a catalyst matrix as JSON and as one self-contained page."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from training.limits.rates import Figures
from training.pages.page import page
from training.studies.catalyst import tables
from training.studies.catalyst.plan import FIRST_VEHICLE
from training.studies.catalyst.rules import LEARNING, TITLES
from training.studies.catalyst.targets import assess, found_text

SCHEMA: Final = "o2train.catalyst_matrix/1"
VERDICTS: Final = {True: "met", False: "missed", None: "not judged"}


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
        "catalyst_matrix.html",
        "Simulated drives with a catalyst",
        verdict=f"{sum(met)} of {len(met)} targets are met.",
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
