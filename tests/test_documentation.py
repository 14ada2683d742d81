"""Pages of the documentation say what exists: files, headings, commands and their options."""

import argparse
import re
import shlex
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path

import pytest

from monitor.base.signals import SIGNALS
from monitor.cli import _parser as o2mon_parser
from monitor.memory.codes import codes_of
from monitor.report.words import Advice, known_faults
from tests.conftest import ROOT
from tests.helpers.run_documentation import blocks, commands, pages
from training.cli import _parser as o2train_parser

PAGES = pages(ROOT)
BLOCKS = [block for page in PAGES for block in blocks(page)]


def links() -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        prose = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)
        for target in re.findall(r"\]\(([^)\s]+)\)", prose):
            if not re.match(r"[a-z]+:", target):
                yield page, target


def anchors(page: Path) -> set[str]:
    prose = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)
    headings = re.findall(r"^#+ (.*)$", prose, flags=re.M)
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", each).lower() for each in headings]
    return {re.sub(r"[^\w\- ]", "", each).strip().replace(" ", "-") for each in plain}


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    broken = []
    for page, target in links():
        place, _, heading = target.partition("#")
        file = page if not place else page.parent / place
        if not file.is_file() or (heading and heading not in anchors(file)):
            broken.append(f"{page.relative_to(ROOT)}: {target}")
    assert not broken


def test_every_page_stands_in_the_navigation_of_the_site() -> None:
    stated = set(re.findall(r"([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), flags=re.M))
    docs = ROOT / "docs"
    assert {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")} == stated


def parse(line: str) -> str:
    """Return what the command's own parser has against a command line, "" for nothing."""
    words = shlex.split(line.removesuffix("&"), comments=True)
    make = {"o2mon": o2mon_parser, "o2train": o2train_parser}[words[0]]
    errors = StringIO()
    try:
        with redirect_stderr(errors):
            make(words[1:]).parse_args(words[1:])
    except SystemExit as ending:
        return errors.getvalue() if ending.code else ""
    except argparse.ArgumentTypeError as error:
        return str(error)
    return ""


def test_every_command_of_the_documentation_exists_with_its_options(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # GIVEN all command lines in blocks, with files that need not exist
    monkeypatch.chdir(tmp_path)
    lines = [(block, line) for block in BLOCKS for line in commands(block.text)]
    own = [(block, line) for block, line in lines if line.split()[0] in ("o2mon", "o2train")]
    assert len(own) > 60
    # WHEN the parser of the command reads each THEN it has nothing against it
    refused = [f"{block.place}: {line}: {said}" for block, line in own if (said := parse(line))]
    assert not refused, "\n".join(refused)


def test_a_wrong_option_is_refused() -> None:
    assert "unrecognized arguments" in parse("o2mon replay drive.log --colour red")
    assert "did you mean --memory?" in parse("o2mon replay drive.log --memry car.db")


def test_installations_take_the_repository_and_extras_that_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    installs = [
        word
        for page in PAGES
        for line in re.findall(r"pip install ([^`#\n]+)", page.read_text())
        for word in shlex.split(line.split("#")[0])
        if not word.startswith("-")
    ]
    assert len(installs) > 5
    for word in installs:
        folder, _, extras = word.removesuffix("]").partition("[")
        assert folder.startswith("."), f"{word} is not published"
        assert (ROOT / folder / "pyproject.toml").is_file(), word
        assert set(filter(None, extras.split(","))) <= set(project["optional-dependencies"]), word


def test_every_block_of_commands_runs_or_says_why_not() -> None:
    # `make test-docs` runs them
    reasons = [block.reason for block in BLOCKS if block.reason is not None]
    assert all(len(reason) > 10 for reason in reasons)
    assert len(BLOCKS) - len(reasons) >= 15


def test_causes_and_next_checks_in_the_docs_are_those_that_the_program_prints() -> None:
    by_advice: dict[str, tuple[Advice, list[str]]] = {}
    for fault, (_, advice) in known_faults().items():
        by_advice.setdefault(advice.check, (advice, []))[1].append(fault)
    groups = [{c for f in own for c in codes_of(f)} for _, own in by_advice.values()]
    owners = Counter(c for group in groups for c in group)
    rows = []
    for advice, own in by_advice.values():
        named = dict.fromkeys(c + f" `{f}`" * (owners[c] > 1) for f in own for c in codes_of(f))
        told = (", ".join(named), advice.effect, "; ".join(advice.causes), advice.check)
        rows.append(f"| {' | '.join(told)} |\n")
    assert "".join(rows) in (ROOT / "docs" / "reference" / "codes.md").read_text(), "".join(rows)


def test_the_page_of_signals_has_every_name_with_its_unit_and_range() -> None:
    page = (ROOT / "docs" / "reference" / "signals.md").read_text(encoding="utf-8")
    rows = [row.strip("| ").split(" | ") for row in page.splitlines() if row.startswith("| `")]
    told = {name.strip("`"): (unit, plausible) for name, unit, _, plausible in rows}
    assert told == {s.name: (s.unit, f"{s.minimum:g} to {s.maximum:g}") for s in SIGNALS}
