"""The report of a study: JSON, one self-contained page, and the lines that the command prints."""

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import monitor
from benchmarks.studies import tables
from benchmarks.studies.targets import Target
from monitor.base.files.outputs import write_text
from training.jobs import run_folder
from training.limits.rates import CONFIDENCE
from training.pages.drawing import Drawing
from training.pages.heat import Heat
from training.pages.page import page, template_of

PACKAGES: Final = ("numpy", "scipy", "numba", "onnxruntime")
TEMPLATE: Final = Path(__file__).with_name("report.html")
MISSED_SHOWN: Final = 3
DEVELOPMENT: Final = "Vehicles with such low numbers serve development: no figure is final."


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the report: a table, a figure, or both."""

    title: str
    rows: Sequence[tables.Row] = ()
    note: str = ""
    figure: Drawing | Heat | None = None

    @property
    def table(self) -> tuple[list[str], list[list[str]]]:
        """Return head and cells of the rows."""
        return tables.cells(self.rows)


@dataclass(frozen=True, slots=True)
class Report:
    """What a study found."""

    title: str
    about: Sequence[str]  # paragraphs; the first one is printed, too
    targets: Sequence[Target]
    sections: Sequence[Section]

    def as_json(self, identity: dict[str, Any]) -> dict[str, Any]:
        """Return targets and tables with all that they depend on."""
        packages = {name: metadata.version(name) for name in PACKAGES}
        packages |= {"o2-monitor": monitor.__version__, "python": platform.python_version()}
        return {
            "source": "simulated",
            **identity,
            "packages": packages,
            "confidence": CONFIDENCE,
            "about": self.about[0],
            "targets": [target.as_row() for target in self.targets],
            "tables": {each.title: list(each.rows) for each in self.sections if each.rows},
        }

    def as_text(self) -> str:
        """Return the first paragraph and the targets as lines."""
        lines = [self.about[0]]
        for what, wanted, found, bounds, trials, verdict in (t.cells() for t in self.targets):
            lines.append(f"{what}: {found} ({bounds}) of {trials}, wanted {wanted}: {verdict}")
        return "\n".join(lines)

    def as_page(self, identity: dict[str, Any]) -> str:
        """Return the page."""
        judged = [t for t in self.targets if t.met is not None]
        missed = [t.cells()[0] for t in judged if not t.met]
        met = [t for t in judged if t.met]
        proved = sum(t.proved is not False for t in met)
        more = f" and {len(missed) - MISSED_SHOWN} more" if len(missed) > MISSED_SHOWN else ""
        why = f" Missed: {'; '.join(missed[:MISSED_SHOWN])}{more}." if missed else ""
        digests = [
            f"{key.removesuffix('_sha256')} {value[:12]}"
            for key, value in identity.items()
            if key.endswith("_sha256")
        ]
        return page(
            template_of(TEMPLATE),
            self.title,
            verdict=f"{len(met)} of {len(judged)} targets are met.{why}",
            confidence=f"{proved} of {len(met)} met targets are proved (their bounds meet them, "
            "too); the others need more drives. Everything here is simulated.",
            kind="bad" if missed else "good",
            about=self.about,
            targets=[t.cells() for t in self.targets],
            sections=self.sections,
            footer=[", ".join(digests)],
        )


def write(report: Report, folder: Path, name: str) -> None:
    """Write the page and NAME.json into the folder of a run, and print the lines."""
    identity = json.loads((folder / run_folder.RUN).read_text())
    print(report.as_text())
    write_text(folder / "report.html", report.as_page(identity))
    run_folder.write_json(folder / f"{name}.json", report.as_json(identity), indent=1)
    print(f"report: {folder / 'report.html'}")
